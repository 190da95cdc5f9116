"""Every case of the tracking study: a world, a path, and what the methods are told of them.

Rule: a case is a value that can be pickled. Cases that differ only in what is told have the
same runs, so that what a wrong assumption costs is seen on the same flights.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from groundstation.localization import SERVICE_MODEL, SignalModel
from groundstation.localization.problem import FloatArray
from groundstation.tracking import TrackingSettings
from sim_sitl.studies.tracking.paths import Path, Shape
from sim_sitl.studies.tracking.world import HEIGHT_ERROR, Labels, World

TIMES_S = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)
"""When answers are taken; a window of each vehicle comes every second, the first at 0."""
WALKING_TIMES_S = (*TIMES_S, 180.0, 240.0, 300.0)
"""The same where somebody walks: noticing it takes time."""
WALKING_M_S = 1.0
"""Speed of those who walk."""
PLACE_ERROR_M = 1.0
"""σ of the error of a vehicle's told place where it is off, east and north each."""
VAGUE_M = 5.0
"""The same where a receiver sees few satellites."""
FACTOR = 1.5
"""How far off a wrong assumption is."""


@dataclass(frozen=True, slots=True)
class Told:
    """What a method assumes."""

    model: SignalModel
    """Priors of the radio."""
    settings: TrackingSettings
    """Of the tracker; its correlation distance is told to the peers as well."""


SERVICE = Told(SERVICE_MODEL, TrackingSettings())
"""The service's own assumptions: far wider than the world is."""


def told_of(world: World) -> Told:
    """The world's own values; how the tracker guards itself against being wrong stays as in the service."""
    model = SignalModel(
        rss_std_db=world.shadowing_db,
        nlos_rss_std_db=world.shadowing_db,
        azimuth_std_rad=world.angle_white_rad,
        elevation_std_rad=world.angle_white_rad,
        los_exponent=world.los_exponent,
        transmit_power_min_dbm=world.power_dbm[0],
        transmit_power_max_dbm=world.power_dbm[1],
        nlos_exponent_min=world.nlos_exponent[0],
        nlos_exponent_max=world.nlos_exponent[1],
        nlos_bias_max_db=world.bias_max_db,
        shared_shadowing=0.0,
        vehicle_position_std_m=min(world.place_error_m, PLACE_ERROR_M),
        vehicle_height_std_m=HEIGHT_ERROR * min(world.place_error_m, PLACE_ERROR_M),
    )
    settings = TrackingSettings(
        correlation_m=world.correlation_m,
        sample_std_db=0.0,
        angle_bias_std_rad=world.angle_constant_rad,
        angle_outlier_probability=0.01,
        los_shares=(0.5,),
    )
    return Told(model, settings)


@dataclass(frozen=True, slots=True)
class Case:
    """One case."""

    name: str
    """Key in ``CASES``."""
    title: str
    """What it is, one line."""
    section: str
    """Key in ``SECTIONS``."""
    world: World
    """What runs are drawn from."""
    path: Path
    """Where the vehicles fly."""
    told: Told
    """What the methods assume, but for those of the service."""
    methods: tuple[str, ...]
    """Names in ``methods.METHODS``: run unless others are asked for."""
    times_s: tuple[float, ...] = TIMES_S
    """When answers are taken."""
    limit_m: float | None = None
    """What no estimator beats in a snapshot, RMSE over thousands of other trials, metres."""
    note: str = ""
    """What a reader must know."""

    @property
    def window_s(self) -> FloatArray:
        """(T,) when windows come, up to the last answer."""
        return np.arange(round(max(self.times_s)) + 1.0)


SECTIONS: Mapping[str, str] = {
    "nlos": "All links obstructed",
    "mixed": "One vehicle in line of sight, three obstructed",
    "los": "All links in line of sight",
    "snapshot": "One window of each vehicle, no movement",
    "walking": "Somebody walks",
    "places": "The vehicles' told places are off, as a satellite receiver's are",
    "wrong": "What is told is wrong",
}

NLOS = World("tracking nlos", (False,) * 4)
MIXED = World("tracking mixed", (True, False, False, False))
LOS = World("tracking los", (True,) * 4)
_YARDSTICK = ("tracker", "centre", "exact")
_PEERS = ("tracker", "particles", "least-squares", "centre", "exact")
_WIDE = ("tracker", "tracker-service", "centre", "exact")


def _flight(
    key: str, title: str, world: World, shape: Shape, methods: tuple[str, ...], note: str = ""
) -> Case:
    return Case(
        f"{key}-{shape.value}", f"{title}, {_PATHS[shape]}", key, world, Path(shape), told_of(world), methods,
        note=note,
    )  # fmt: skip


_PATHS = {
    Shape.ORBIT: "fixed orbit",
    Shape.CONTRACTING: "orbits contracting on the area's centre",
    Shape.ORACLE: "spiral round the truth (an oracle)",
}


def _walking(key: str, title: str, world: World) -> Case:
    moving = replace(world, walking_m_s=WALKING_M_S)
    return Case(
        f"{key}-walking", f"{title}, fixed orbit, a walk of {WALKING_M_S:g} m/s", "walking", moving,
        Path(Shape.ORBIT), told_of(moving), ("tracker", "still", "centre"), WALKING_TIMES_S,
        note="He keeps a heading for about a minute and turns at the area's edge. Nobody is told.",
    )  # fmt: skip


def _misplaced(key: str, title: str, world: World, shape: Shape) -> Case:
    return replace(
        _flight(key, title, replace(world, place_error_m=PLACE_ERROR_M), shape, ("tracker", "centre")),
        name=f"{key}-misplaced" + ("" if shape is Shape.ORBIT else f"-{shape.value}"),
        title=f"{title}, {_PATHS[shape]}, vehicles' places off by {PLACE_ERROR_M:g} m",
        section="places",
        note=f"Off by {PLACE_ERROR_M:g} m on each horizontal axis and twice that in height, for minutes, half"
        " of it (in variance) alike for all vehicles. Told as what it is.",
    )


def _vague(key: str, title: str, world: World, said: bool) -> Case:
    vague = replace(world, place_error_m=VAGUE_M, place_error_said=said)
    return replace(
        _flight(key, title, vague, Shape.ORBIT, ("tracker", "centre")),
        name=f"{key}-vague" + ("" if said else "-unsaid"),
        title=f"{title}, {_PATHS[Shape.ORBIT]}, vehicles' places off by {VAGUE_M:g} m"
        + (" and said so" if said else " and not said"),
        section="places",
        note=f"Assumed is {PLACE_ERROR_M:g} m; the vehicles "
        + (f"say that it is {VAGUE_M:g}." if said else "say nothing."),
    )


def _snapshot(key: str, title: str, world: World, limit_m: float) -> Case:
    one = replace(world, angle_constant_rad=0.0)
    return Case(
        f"{key}-snapshot", title, "snapshot", one, Path(Shape.ORBIT), told_of(one), _YARDSTICK, (0.0,),
        limit_m,
    )  # fmt: skip


def _wrong(name: str, title: str, model: Mapping[str, float], settings: Mapping[str, float]) -> Case:
    right = told_of(NLOS)
    told = Told(replace(right.model, **model), replace(right.settings, **settings))  # type: ignore[arg-type]
    return Case(f"wrong-{name}", title, "wrong", NLOS, Path(Shape.ORBIT), told, ("tracker",))


def _exponents(factor: float) -> dict[str, float]:
    low, high = NLOS.nlos_exponent
    return {"nlos_exponent_min": factor * low, "nlos_exponent_max": factor * high}


def _sigma(factor: float) -> dict[str, float]:
    return {"rss_std_db": factor * NLOS.shadowing_db, "nlos_rss_std_db": factor * NLOS.shadowing_db}


_RUINED = replace(NLOS, ruined_share=0.1)
_MISLABELLED = replace(MIXED, labels=Labels("wrong"))

CASES: dict[str, Case] = {
    case.name: case
    for case in (
        _flight("nlos", "NLOS", NLOS, Shape.ORBIT, (*_WIDE, *_PEERS)),
        _flight("nlos", "NLOS", NLOS, Shape.CONTRACTING, _PEERS),
        _flight("nlos", "NLOS", NLOS, Shape.ORACLE, _YARDSTICK),
        _flight("mixed", "Mixed", MIXED, Shape.ORBIT, _PEERS),
        _flight("mixed", "Mixed", MIXED, Shape.CONTRACTING, _YARDSTICK),
        _flight("mixed", "Mixed", MIXED, Shape.ORACLE, _YARDSTICK),
        replace(
            _flight("mixed", "Mixed", replace(MIXED, labels=Labels("soft")), Shape.ORBIT, _WIDE),
            name="mixed-soft",
            title="Mixed, fixed orbit, labels of a classifier (AUC 0.97)",
            note="The exact filter is told the true states; the others each window's probability.",
        ),
        _flight("los", "LOS", LOS, Shape.ORBIT, _YARDSTICK),
        _snapshot("los", "LOS, angles 1° white", LOS, 1.88),
        _snapshot("nlos", "NLOS, b_k ≤ 7 dB", replace(NLOS, bias_max_db=7.0), 45.0),
        _snapshot("mixed", "Mixed, b_k ≤ 7 dB, angles 1° white", replace(MIXED, bias_max_db=7.0), 14.1),
        _walking("nlos", "NLOS", NLOS),
        _walking("mixed", "Mixed", MIXED),
        _misplaced("nlos", "NLOS", NLOS, Shape.ORBIT),
        _misplaced("mixed", "Mixed", MIXED, Shape.ORBIT),
        _misplaced("mixed", "Mixed", MIXED, Shape.ORACLE),
        _misplaced("los", "LOS", LOS, Shape.ORBIT),
        _vague("mixed", "Mixed", MIXED, True),
        _vague("mixed", "Mixed", MIXED, False),
        _wrong("exponent-high", "exponents told × 1.5: 3 to 5.25", _exponents(FACTOR), {}),
        _wrong("exponent-low", "exponents told / 1.5: 1.33 to 2.33", _exponents(1.0 / FACTOR), {}),
        _wrong("sigma-high", "σ told × 1.5: 7.5 dB", _sigma(FACTOR), {}),
        _wrong("sigma-low", "σ told / 1.5: 3.3 dB", _sigma(1.0 / FACTOR), {}),
        _wrong("correlation-high", "correlation told × 1.5: 37.5 m", {}, {"correlation_m": 37.5}),
        _wrong("correlation-low", "correlation told / 1.5: 16.7 m", {}, {"correlation_m": 25.0 / FACTOR}),
        replace(
            _wrong("ruined", "one window in ten 20 dB off, up or down", {}, {}),
            world=_RUINED,
        ),
        replace(
            _flight("mixed", "", _MISLABELLED, Shape.ORBIT, ("tracker",)),
            name="wrong-labels",
            title="mixed, the classifier wrong one time in five and sure (0.95) of itself",
            section="wrong",
        ),
    )
}
