"""The one place that imports the generated dialect module.

The module has no types and exists only after a build; whoever needs its message classes takes
``dialect`` from here and gets a clear error where it is missing. Framing, decoding and routing
do not need it: see catalogue.py.
"""

from __future__ import annotations

from typing import Any

from groundstation.domain.errors import ResourceError

try:
    from groundstation.mavlink.generated import sar_radio
except ModuleNotFoundError as error:
    raise ResourceError(
        "the MAVLink dialect has not been generated; run: python -m groundstation.mavlink.generate"
    ) from error

dialect: Any = sar_radio
"""pymavlink's module for sar_radio.xml: ``MAVLink_…_message`` classes, enums, ``MAVLink``."""
