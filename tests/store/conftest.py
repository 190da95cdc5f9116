"""Records and frames that several store tests need."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import Direction, FrameInput, Record
from groundstation.domain.target import Environment, TargetState

START_NS = 1_795_311_900_000_000_000


@pytest.fixture
def frame_record() -> Callable[[int], Record]:
    """Makes the frame record with sequence number ``seq``."""

    def make(seq: int) -> Record:
        frame = b"\xfd" + seq.to_bytes(4, "big") * (3 + seq % 5)
        direction = Direction.OUT if seq % 7 == 0 else Direction.IN
        time_ns = START_NS + seq * 1_000_000
        return Record(seq, time_ns, time_ns // 1000 + 5, FrameInput("udpin:0.0.0.0:14550", direction, frame))

    return make


@pytest.fixture
def target_state() -> Callable[..., TargetState]:
    """Makes a belief of one beacon."""

    def make(beacon_id: int = 2**64 - 1, sequence: int = 1, time_ns: int = START_NS) -> TargetState:
        return TargetState(
            beacon_id=beacon_id,
            time_ns=time_ns,
            first_heard_ns=START_NS,
            last_heard_ns=time_ns,
            position=Geodetic(-35.3625, 149.1654, 584.25),
            covariance_enu_m2=(9.0, 1.0, 0.5, 16.0, 0.25, 4.0),
            radius_90_m=8.5,
            environment=Environment.MIXED,
            los_links=2,
            links=4,
            windows=12,
            method="lsre-ccp",
            height_reference="home",
            sequence=sequence,
            snapshot=None,
        )

    return make
