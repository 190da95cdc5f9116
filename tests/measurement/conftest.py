import pytest
from hypothesis import settings as hypothesis_settings

from groundstation.measurement.settings import MeasurementSettings

# A loaded machine must not fail a property: pytest-timeout bounds the time instead.
hypothesis_settings.register_profile("no-deadline", deadline=None)
hypothesis_settings.load_profile("no-deadline")


@pytest.fixture
def settings() -> MeasurementSettings:
    return MeasurementSettings()
