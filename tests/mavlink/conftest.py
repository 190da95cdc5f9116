"""What several MAVLink tests need."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from groundstation.mavlink.tlog import read_tlog

# A loaded machine is slow, not wrong.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

RECORDING = Path(__file__).parents[1] / "data" / "arducopter-4x.tlog"


@pytest.fixture(scope="session")
def recording_path() -> Path:
    """Four real ArduCopters, 275 s."""
    return RECORDING


@pytest.fixture(scope="session")
def recorded_frames() -> list[bytes]:
    """All frames of the recording."""
    return [frame for _unix_us, frame in read_tlog(RECORDING)]
