"""The windows that a belief remembers, and how each is related to those before it.

Exists because a belief is rebuilt from its windows (other boxes, another area) and because
windows resemble each other: whom each is conditioned on is settled here, once, on arrival.
Rules: memory is bounded, and what had to go is counted; a window from a place heard from often
enough is refused and counted; no candidate position enters here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from groundstation.localization.likelihood import shared_variance_m2
from groundstation.localization.mesh import IntArray
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.localization.whitening import Observations, informative_parents
from groundstation.tracking.settings import TrackingSettings

_COLUMNS = 17
(
    _EAST, _NORTH, _UP, _LINK, _RSS, _LOS, _WHITE, _AZ, _EL, _AZ_STD, _EL_STD, _FRESH, _ANGLE_P,
    _TIME, _SHARP, _FLAT2, _UPRIGHT2,
) = range(_COLUMNS)  # fmt: skip
LINK, RSS, WHITE, TIME = _LINK, _RSS, _WHITE, _TIME
"""Columns of a row: number of its vehicle; its power, dBm; that power's white variance, dB²; its end, s."""
_LEAST_FRESH = 0.02


@dataclass(frozen=True, slots=True)
class TrackObservation:
    """What the tracker needs of one link window."""

    vehicle_id: int
    position_enu_m: tuple[float, float, float]
    """Where the vehicle was, metres ENU."""
    rss_dbm: float | None
    rss_std_error_db: float | None
    """Standard error of the average; None = not known."""
    azimuth_rad: float | None
    elevation_rad: float | None
    azimuth_std_rad: float | None
    """Standard error of the averaged azimuth; None = the model's."""
    elevation_std_rad: float | None
    los_probability: float
    classified: bool = True
    """False: nobody judged the link, ``los_probability`` is a prior. Its power is then taken as
    NLOS, whose model is broad enough for both; its angles count by the beacon's other ones."""
    time_s: float = 0.0
    """End of the window, station time, seconds."""
    position_std_m: float | None = None
    """How far off the vehicle's place may be, each horizontal axis; None = as the model has it."""
    height_std_m: float | None = None
    """The same of its height."""


@dataclass(slots=True)
class Counts:
    """What became of one vehicle's windows since the first."""

    taken: int = 0
    redundant: int = 0
    outliers: int = 0


class History:
    """n windows in order of arrival; see the module."""

    def __init__(self, model: SignalModel, settings: TrackingSettings) -> None:
        self._model, self._settings = model, settings
        self.vehicles: list[int] = []
        """Vehicles in order of their first window: their place is their link's number."""
        self.counts: list[Counts] = []
        """Of each of ``vehicles``."""
        self._rows: FloatArray = np.zeros((0, _COLUMNS))
        self._parents: Any = np.zeros((0, self._settings.parents), dtype=np.int64)
        self._stale = False
        """Whether windows were forgotten since the older ones were related."""

    @property
    def count(self) -> int:
        """n."""
        return int(self._rows.shape[0])

    @property
    def rows(self) -> FloatArray:
        """(n, columns) the windows, as ``row`` gives them; to read."""
        return self._rows

    def row(self, window: TrackObservation) -> list[float] | None:
        """The window as numbers; None: it tells neither a power nor a usable bearing."""
        nothing, rss_dbm = math.nan, window.rss_dbm
        if rss_dbm is None or not math.isfinite(rss_dbm):
            rss_dbm = nothing
        azimuth_rad, elevation_rad = window.azimuth_rad, window.elevation_rad
        if (
            azimuth_rad is None
            or elevation_rad is None
            or not (math.isfinite(azimuth_rad) and math.isfinite(elevation_rad))
            or not window.los_probability > 0.0
        ):
            azimuth_rad = elevation_rad = nothing
        if math.isnan(rss_dbm) and math.isnan(azimuth_rad):
            return None
        if not all(map(math.isfinite, window.position_enu_m)):
            return None
        if window.vehicle_id not in self.vehicles:
            self.vehicles.append(window.vehicle_id)
            self.counts.append(Counts())
        probability = min(max(window.los_probability, 0.0), 1.0)
        model = self._model
        flat_m, upright_m = window.position_std_m, window.height_std_m
        return [
            *window.position_enu_m,
            self.vehicles.index(window.vehicle_id),
            rss_dbm,
            probability if window.classified else 0.0,
            self._settings.sample_std_db**2 + (window.rss_std_error_db or 0.0) ** 2,
            azimuth_rad,
            elevation_rad,
            max(window.azimuth_std_rad or 0.0, model.azimuth_std_rad),
            max(window.elevation_std_rad or 0.0, model.elevation_std_rad),
            1.0,
            min(max(probability, 0.01), 0.99) if window.classified else 0.5,
            window.time_s,
            1.0,
            (model.vehicle_position_std_m if flat_m is None else flat_m) ** 2,
            (model.vehicle_height_std_m if upright_m is None else upright_m) ** 2,
        ]

    def take(self, rows: FloatArray) -> int:
        """Append rows (m, columns), each related to those before it; returns how many were new.

        The others come from a place heard from often enough, and are counted with their vehicle.
        """
        kept = self._relate(rows, refuse=True)
        for link, new in zip(rows[:, _LINK].astype(int).tolist(), kept.tolist(), strict=True):
            if new:
                self.counts[link].taken += 1
            else:
                self.counts[link].redundant += 1
        return int(kept.sum())

    def _relate(self, rows: FloatArray, refuse: bool) -> Any:
        settings, before, more = self._settings, self.count, rows.shape[0]
        rows = rows.copy()
        every, numbers = np.concatenate([self._rows, rows]), np.arange(before, before + more)
        of_same, gap2 = _earlier_of_same(every, numbers)
        kept = np.ones(before + more, dtype=bool)
        if refuse:
            near = of_same & (gap2 < settings.place_radius_m**2)
            if near.sum(axis=1).max() >= settings.windows_per_place:
                for number in range(more):
                    kept[before + number] = (near[number] & kept).sum() < settings.windows_per_place
        parents, rows[:, _FRESH], rows[:, _SHARP] = self._relations(every, numbers, kept, of_same, gap2)
        place = np.cumsum(kept) - 1
        parents = np.where(parents >= 0, place[parents], -1)
        new = kept[before:]
        self._rows = np.concatenate([self._rows, rows[new]])
        self._parents = np.concatenate([self._parents, parents[new]])
        return new

    def _relations(self, every: FloatArray, numbers: Any, kept: Any, of_same: Any, gap2: Any) -> Any:
        """Parents of the rows ``numbers`` of ``every`` among those ``kept``, and how fresh and sharp their
        angles are; ``of_same`` and ``gap2`` as ``_earlier_of_same`` gives them."""
        settings = self._settings
        usable = np.arange(len(every)) < numbers[:, None]
        usable &= kept & np.isfinite(every[:, _RSS])
        nobody = np.full((len(every), 0), -1, dtype=np.int64)
        parents = informative_parents(
            observations_of(every, nobody),
            numbers,
            usable,
            settings.parents,
            settings.correlation_m,
            self._model,
        )
        told = of_same & kept & np.isfinite(every[:, _AZ])
        gap = np.sqrt(np.where(told, gap2, np.inf).min(axis=1))
        fresh, sharp = (
            np.maximum(-np.expm1(-2.0 * gap / reach_m), _LEAST_FRESH)
            for reach_m in (settings.correlation_m, settings.angle_correlation_m)
        )
        return parents, fresh, sharp

    def vehicle_variance_m2(self) -> tuple[float, float]:
        """What the vehicles' places leave unsure of any answer: each horizontal axis, and height, m²."""
        rows = self._rows
        if not len(rows):
            return self._model.vehicle_variance_m2
        counts = np.where(np.isfinite(rows[:, _AZ]), rows[:, _ANGLE_P], 0.0)
        return shared_variance_m2(rows[:, _FLAT2 : _UPRIGHT2 + 1], counts, self._model)

    def observations(self) -> Observations:
        """All windows, as the likelihood wants them; after ``forget`` the older ones are related to none."""
        return observations_of(self._rows, self._parents)

    def relate_again(self) -> None:
        """Relate the older windows, after some were forgotten, to those that are left."""
        if self._stale:
            self._relate_all(self._rows)

    def related_some(self, numbers: Any) -> Observations:
        """As after ``relate_again`` in the windows ``numbers``, which rise, and nothing changes."""
        if not self._stale:
            return self.observations()
        rows, parents = self._rows.copy(), self._parents.copy()
        kept = np.ones(self.count, dtype=bool)
        parents[numbers], rows[numbers, _FRESH], rows[numbers, _SHARP] = self._relations(
            rows, numbers, kept, *_earlier_of_same(rows, numbers)
        )
        return observations_of(rows, parents)

    def related(self) -> Observations:
        """As after ``relate_again``, and nothing changes."""
        return self.related_some(np.arange(self.count))

    def widen(self, rows: Any, variance_db2: FloatArray) -> None:
        """Outliers: add to the white variance of the powers of ``rows``."""
        self._rows[rows, _WHITE] += variance_db2
        for link in self._rows[rows, _LINK].astype(int).tolist():
            self.counts[link].outliers += 1

    def forget(self) -> IntArray:
        """When it is full, drop every second window of each vehicle's older two thirds; their numbers.

        Those left are related anew by ``relate_again``: it costs as much as ten updates.
        """
        if self.count <= self._settings.maximum_windows:
            return np.zeros(0, dtype=np.int64)
        dropped = []
        for link in range(len(self.vehicles)):
            mine = np.flatnonzero(self._rows[:, _LINK] == link)
            dropped.append(mine[: 2 * mine.size // 3][1::2])
        drop = np.concatenate(dropped)
        if not drop.size:
            drop = np.arange(self.count - self._settings.maximum_windows)
        keep = np.ones(self.count, dtype=bool)
        keep[drop] = False
        self._rows = self._rows[keep]
        self._parents = np.full((self.count, self._settings.parents), -1, dtype=np.int64)
        self._stale = True
        return drop

    def absorb(self, other: History) -> int:
        """Take in another's windows in order of their times; returns how many were forgotten."""
        for vehicle in other.vehicles:
            if vehicle not in self.vehicles:
                self.vehicles.append(vehicle)
                self.counts.append(Counts())
        where = [self.vehicles.index(vehicle) for vehicle in other.vehicles]
        for link, theirs in zip(where, other.counts, strict=True):
            mine = self.counts[link]
            mine.taken += theirs.taken
            mine.redundant += theirs.redundant
            mine.outliers += theirs.outliers
        rows = other._rows.copy()
        if rows.size:
            rows[:, _LINK] = np.array(where, dtype=np.float64)[rows[:, _LINK].astype(int)]
        rows = np.concatenate([self._rows, rows])
        self._relate_all(rows[np.argsort(rows[:, _TIME], kind="stable")])
        before = self.count
        while self.forget().size:
            pass
        return before - self.count

    def _relate_all(self, rows: FloatArray) -> None:
        """Make ``rows`` the whole history, each related to those before it."""
        self._stale = False
        self._rows = np.zeros((0, _COLUMNS))
        self._parents = np.zeros((0, self._settings.parents), dtype=np.int64)
        if rows.size:
            self._relate(rows, refuse=False)

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values."""
        return {
            "vehicles": list(self.vehicles),
            "counts": [
                [vehicle, count.taken, count.redundant, count.outliers]
                for vehicle, count in zip(self.vehicles, self.counts, strict=True)
            ],
            "rows": self._rows.copy(),
            "parents": self._parents.copy(),
            "stale": self._stale,
        }

    def restore(self, tree: dict[str, Any]) -> bool:
        """Take back what ``state`` gave. False: it was kept with other settings, and is related anew."""
        self.vehicles = [int(vehicle) for vehicle in tree["vehicles"]]
        kept = {int(vehicle): counts for vehicle, *counts in tree.get("counts", [])}
        self.counts = [
            Counts(*(int(value) for value in kept.get(vehicle, (0, 0, 0)))) for vehicle in self.vehicles
        ]
        parents = np.array(tree["parents"], dtype=np.int64)
        count = parents.shape[0]
        rows = np.array(tree["rows"], dtype=np.float64).reshape(count, -1 if count else _COLUMNS)
        if count and (parents.shape[1] != self._settings.parents or rows.shape[1] != _COLUMNS):
            # The windows are evidence still, their relations are not; older ones have fewer columns.
            had = rows.shape[1]
            rows = np.pad(rows, ((0, 0), (0, _COLUMNS - had)))
            if had <= _SHARP:
                rows[:, _SHARP] = 1.0
            if had <= _FLAT2:
                rows[:, _FLAT2:] = self._model.vehicle_variance_m2
            self._relate_all(rows)
            return False
        self._rows, self._parents = rows, parents.reshape(count, self._settings.parents)
        self._stale = bool(tree.get("stale", False))
        return True


def one_window_a_vehicle(batch: list[TrackObservation]) -> list[list[TrackObservation]]:
    """The batch, in order, in groups that hold no vehicle twice."""
    groups: list[list[TrackObservation]] = []
    seen: set[int] = set()
    for window in batch:
        if not groups or window.vehicle_id in seen:
            groups.append([])
            seen = set()
        groups[-1].append(window)
        seen.add(window.vehicle_id)
    return groups


def _earlier_of_same(every: FloatArray, numbers: Any) -> tuple[Any, FloatArray]:
    """(r, n) which rows of ``every`` are earlier ones of the vehicle of each of ``numbers``; and how far
    apart all are, m²."""
    gap2 = cdist(every[numbers, :3], every[:, :3], "sqeuclidean")
    of_same = every[numbers, _LINK, None] == every[:, _LINK]
    of_same &= np.arange(len(every)) < numbers[:, None]
    return of_same, gap2


def observations_of(rows: FloatArray, parents: Any) -> Observations:
    """Rows (n, columns) as ``History.row`` gives them, conditioned on ``parents`` (n, m)."""
    return Observations(
        rows[:, :3],
        rows[:, _LINK].astype(np.int64),
        rows[:, _RSS],
        rows[:, _LOS],
        rows[:, _WHITE],
        rows[:, _AZ],
        rows[:, _EL],
        rows[:, _AZ_STD : _EL_STD + 1] / np.sqrt(rows[:, _SHARP, None]),
        rows[:, _ANGLE_P],
        rows[:, _FRESH],
        parents,
        rows[:, _FLAT2 : _UPRIGHT2 + 1],
    )
