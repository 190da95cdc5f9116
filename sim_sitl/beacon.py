"""When a beacon transmits: the same packets for every vehicle that may hear them.

Keeps the rule that a packet and its sequence number exist whether anybody hears them or not:
what is lost shows as a gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.domain.errors import InputError
from groundstation.domain.geometry import Enu
from sim_sitl.randomness import Stream, generator
from sim_sitl.scenario import BeaconSpec, Scenario

GENERATED_ID = 9001
"""Device id of the first beacon that is drawn because a scenario has fewer than asked for."""
JITTER = 0.05
"""Of the packet interval, uniform: phones are not synchronous."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One transmission."""

    time_s: float
    beacon: int
    """Index of the beacon in the run."""
    sequence: int
    """uint16, one counter per beacon."""


class BeaconTransmitter:
    """The packets of one beacon, in order of time."""

    def __init__(self, spec: BeaconSpec, index: int, seed: int) -> None:
        self.spec = spec
        self.index = index
        self._rng = generator(seed, Stream.PACKETS, index)
        self._phase_s = float(self._rng.random()) * spec.packet_interval_s
        self._count = 0
        self._next_s = self._phase_s

    def until(self, time_s: float) -> list[Packet]:
        """Packets sent up to and including ``time_s`` since the last call."""
        packets: list[Packet] = []
        while self._next_s <= time_s:
            packets.append(Packet(self._next_s, self.index, self._count & 0xFFFF))
            self._count += 1
            jitter = JITTER * (float(self._rng.random()) - 0.5)
            self._next_s = self._phase_s + (self._count + jitter) * self.spec.packet_interval_s
        return packets


def choose_beacons(scenario: Scenario, count: int | None, seed: int) -> tuple[BeaconSpec, ...]:
    """The scenario's first ``count`` beacons (None: all), more drawn in the search area if it has fewer.

    Drawn ones: uniform in the area and between the height limits (at most 3 m up), transmit
    power uniform in 13–18 dBm, not buried.
    """
    if count is None or count <= len(scenario.beacons):
        return scenario.beacons[:count]
    rng = generator(seed, Stream.BEACON_PLACE)
    beacons = list(scenario.beacons)
    taken = {beacon.beacon_id for beacon in beacons}
    next_id = GENERATED_ID
    while len(beacons) < count:
        while next_id in taken:
            next_id += 1
        taken.add(next_id)
        low = max(scenario.target_height_min_m, 0.5)
        position: Enu = (
            *_draw(scenario, rng),
            float(rng.uniform(low, max(low, min(scenario.target_height_max_m, 3.0)))),
        )
        beacons.append(
            BeaconSpec(next_id, position, round(float(rng.uniform(13.0, 18.0)), 1), 1.0, 867_500_000, 0.0)
        )
    return tuple(beacons)


def _draw(scenario: Scenario, rng: np.random.Generator) -> tuple[float, float]:
    """A place uniform in the search area."""
    east = [corner[0] for corner in scenario.area.corners_m]
    north = [corner[1] for corner in scenario.area.corners_m]
    for _ in range(10_000):
        place = float(rng.uniform(min(east), max(east))), float(rng.uniform(min(north), max(north)))
        if scenario.area.contains(*place):
            return place
    raise InputError(f"scenario {scenario.name!r}: its search area holds no room; needed: a simple polygon")
