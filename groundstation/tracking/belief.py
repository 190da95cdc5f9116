"""One beacon's belief: every window of every vehicle, fused where the person could be.

Exists because a snapshot in rubble cannot be better than about half the area's radius, and
movement can. Rules: every window comes in (none is silently lost: taken, redundant or
without content); consecutive windows of a vehicle are not independent evidence (the shared
likelihood conditions on the nearest earlier ones); the belief can be rebuilt from its
bounded history, over another search area too; same inputs, same numbers.

A still person is assumed. The candidates are boxes (``localization.mesh``) that split where
the belief gathers; between splits an update costs a few products of arrays. Over 400 lines: history,
mesh and running evidence are one state, rebuilt together from the history.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundstation.localization.likelihood import ExponentGrid
from groundstation.localization.mesh import IntArray, Mesh, MeshSettings, masses, refine
from groundstation.localization.problem import FloatArray, SearchArea, SignalModel
from groundstation.localization.regression import Evidence, Observations, angle_log_likelihood, whiten
from groundstation.tracking.settings import TrackingSettings

_COLUMNS = 13
_EAST, _NORTH, _UP, _LINK, _RSS, _LOS, _WHITE, _AZ, _EL, _AZ_STD, _EL_STD, _FRESH, _ANGLE_P = range(_COLUMNS)


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


@dataclass(frozen=True, slots=True)
class Update:
    """What became of a batch of windows."""

    taken: int
    redundant: int
    """From a place already heard from often enough."""
    empty: int
    """Neither power nor usable angles."""
    outliers: int
    """Taken with less weight."""
    forgotten: int
    """Old windows that had to make room."""


class Belief:
    """Belief over one beacon's position; see the module."""

    def __init__(self, area: SearchArea, model: SignalModel, settings: TrackingSettings) -> None:
        self._settings = settings
        self._model = replace(
            model,
            angle_outlier_probability=settings.angle_outlier_probability,
            los_shares=settings.los_shares,
        )
        self._exponents = ExponentGrid.of(self._model)
        foreign = settings.foreign_parents if model.shared_shadowing > 0.0 else 0
        self._width = settings.parents + foreign
        self._mesh_settings = MeshSettings(
            base_cells=settings.base_cells,
            maximum_cells=settings.maximum_cells,
            split_mass=settings.split_mass,
            minimum_half_m=settings.minimum_half_m,
        )
        self._area = area
        self._vehicles: list[int] = []
        self._rows: FloatArray = np.zeros((0, _COLUMNS))
        self._weights: FloatArray = np.zeros(0)
        self._parents: Any = np.zeros((0, self._width), dtype=np.int64)
        self._mesh = Mesh(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0))
        self._evidence = Evidence.empty(0, 0, len(settings.los_shares))
        self._log_likelihood: FloatArray = np.zeros(0)
        self._remesh_mass = settings.remesh_mass
        self._rebuild()

    @property
    def mesh(self) -> Mesh:
        """The candidate boxes."""
        return self._mesh

    @property
    def mass(self) -> FloatArray:
        """(C,) share of the belief in each box."""
        return masses(self._log_likelihood, self._mesh)

    @property
    def area(self) -> SearchArea:
        """Where the target may be."""
        return self._area

    @property
    def windows(self) -> int:
        """Windows remembered."""
        return int(self._rows.shape[0])

    @property
    def vehicles(self) -> tuple[int, ...]:
        """Vehicles heard from, in order of their first window."""
        return tuple(self._vehicles)

    def transmit_power_dbm(self) -> float:
        """Posterior mean at the most likely place."""
        best = int(np.argmax(self._log_likelihood))
        _, los, nlos = self._evidence.exponents_at(best, self._exponents)
        nuisance = self._evidence.nuisances_at(best, los, nlos)
        return self._model.transmit_power_mean_dbm + self._model.transmit_power_std_db * float(nuisance[0])

    def set_area(self, area: SearchArea) -> None:
        """Take another search area; all remembered windows count there too."""
        self._area = area
        self._rebuild()

    def update(self, batch: list[TrackObservation]) -> Update:
        """Take in windows, in order. One call a tick costs less than one a window."""
        first = judged = self.windows
        redundant = empty = outliers = 0
        for window in batch:
            row = self._row(window)
            if row is None:
                empty += 1
                continue
            near, parents, weight = self._relatives(row)
            if near >= self._settings.windows_per_place:
                redundant += 1
                continue
            if judged < self.windows and (self._rows[judged:, _LINK] == row[_LINK]).any():
                # A vehicle's next window is judged against this one: this one is judged first.
                outliers += self._weigh_down_outliers(judged)
                judged = self.windows
            self._append(row, parents, weight)
        taken = self.windows - first
        if taken == 0:
            return Update(0, redundant, empty, 0, 0)
        outliers += self._weigh_down_outliers(judged)
        forgotten = self._forget()
        if forgotten:
            self._rebuild()
        else:
            self._take(first)
            if self._heaviest() > self._remesh_mass:
                self._rebuild()
        return Update(taken, redundant, empty, outliers, forgotten)

    def _row(self, window: TrackObservation) -> FloatArray | None:
        has_rss = window.rss_dbm is not None and math.isfinite(window.rss_dbm)
        has_angle = (
            window.azimuth_rad is not None
            and window.elevation_rad is not None
            and math.isfinite(window.azimuth_rad)
            and math.isfinite(window.elevation_rad)
            and window.los_probability > 0.0
        )
        if not (has_rss or has_angle) or not all(map(math.isfinite, window.position_enu_m)):
            return None
        if window.vehicle_id not in self._vehicles:
            self._vehicles.append(window.vehicle_id)
        white = self._settings.sample_std_db**2 + (window.rss_std_error_db or 0.0) ** 2
        probability = min(max(window.los_probability, 0.0), 1.0)
        bias = self._settings.angle_bias_std_rad
        az_std = max(window.azimuth_std_rad or 0.0, self._model.azimuth_std_rad)
        el_std = max(window.elevation_std_rad or 0.0, self._model.elevation_std_rad)
        return np.array(
            [
                *window.position_enu_m,
                self._vehicles.index(window.vehicle_id),
                window.rss_dbm if has_rss else math.nan,
                probability if window.classified else 0.0,
                white,
                window.azimuth_rad if has_angle else math.nan,
                window.elevation_rad if has_angle else math.nan,
                math.hypot(az_std, bias),
                math.hypot(el_std, bias),
                1.0,
                min(max(probability, 0.01), 0.99) if window.classified else 0.5,
            ]
        )

    def _append(self, row: FloatArray, parents: Any, weight: float) -> None:
        self._rows = np.concatenate([self._rows, row[None]])
        self._parents = np.concatenate([self._parents, parents[None]])
        self._weights = np.append(self._weights, weight)

    def _angle_weight(self, row: FloatArray, same: Any) -> float:
        """Share of independent evidence in a window's angles.

        With white error σ_w and a constant error σ_c of the vehicle, n windows are worth
        n(σ_w² + σ_c²)/(σ_w² + n σ_c²): this window gets what it adds to that. Windows of one
        place count as the part that is new there. Conservative: a constant error shows
        itself when the geometry changes, which is not used.
        """
        constant = self._settings.angle_bias_std_rad**2
        both = float(row[_AZ_STD]) ** 2
        white = both - constant
        heard = same[np.isfinite(self._rows[same, _AZ])]
        before = float(self._rows[heard, _FRESH].sum())
        after = before + float(row[_FRESH])
        worth = [count * both / (white + count * constant) for count in (before, after)]
        return worth[1] - worth[0]

    def _relatives(self, row: FloatArray) -> tuple[int, Any, float]:
        """How many earlier windows share the place, the nearest ones, and what the angles still add."""
        parents = np.full(self._width, -1, dtype=np.int64)
        row[_FRESH] = 1.0
        others = np.flatnonzero((self._rows[:, _LINK] != row[_LINK]) & np.isfinite(self._rows[:, _RSS]))
        if others.size and self._width > self._settings.parents:
            away = np.square(self._rows[others, :3] - row[:3]).sum(axis=1)
            close = others[_smallest(away, self._settings.foreign_parents)]
            parents[self._settings.parents : self._settings.parents + close.size] = close
        same = np.flatnonzero(self._rows[:, _LINK] == row[_LINK])
        if not same.size:
            return 0, parents, self._angle_weight(row, same)
        gap = np.sqrt(np.square(self._rows[same, :3] - row[:3]).sum(axis=1))
        near = int((gap < self._settings.place_radius_m).sum())
        heard = np.flatnonzero(np.isfinite(self._rows[same, _RSS]))
        closest = heard[_smallest(gap[heard], self._settings.parents)]
        parents[: closest.size] = same[closest]
        resemblance = math.exp(-float(gap.min()) / self._settings.correlation_m)
        row[_FRESH] = max(1.0 - resemblance**2, 0.02)
        return near, parents, self._angle_weight(row, same)

    def _observations(self) -> Observations:
        rows = self._rows
        return Observations(
            rows[:, :3],
            rows[:, _LINK].astype(np.int64),
            rows[:, _RSS],
            rows[:, _LOS],
            rows[:, _WHITE],
            rows[:, _AZ],
            rows[:, _EL],
            rows[:, _AZ_STD : _EL_STD + 1],
            rows[:, _ANGLE_P],
            self._weights,
            self._parents,
        )

    def _weigh_down_outliers(self, first: int) -> int:
        """Widen what is implausible at every likely place (Huber's weight, once, on arrival)."""
        self._evidence.grow(len(self._vehicles))
        mass = self.mass
        likely = np.flatnonzero(mass > 1e-3 * mass.max())
        likely = likely[np.argsort(-mass[likely], kind="stable")[:64]]
        best = int(np.argmax(mass))
        _, los, nlos = self._evidence.exponents_at(best, self._exponents)
        observations = self._observations()
        rows = whiten(observations, first, len(self._vehicles), self._settings.correlation_m, self._model)
        if not rows.rows.size:
            return 0
        places = self._mesh.center_enu_m[likely]
        path_los, path_nlos = Evidence.path_rows(observations, rows, places)
        right = (
            self._evidence.level_loading[:, None]
            + los * self._evidence.loading_path[0][:, likely]
            + nlos * self._evidence.loading_path[1][:, likely]
        )
        precision = self._evidence.loading_loading
        expected = rows.loading @ np.linalg.solve(precision, right)
        residual = rows.level[:, None] + los * path_los + nlos * path_nlos - expected
        spread = np.einsum("rv,rv->r", rows.loading, np.linalg.solve(precision, rows.loading.T).T)
        # Exponents are taken at the best place only: half a unit of doubt in them is allowed for.
        doubt = 0.25 * path_nlos**2 if self._exponents.nlos.size > 1 else 0.0 * path_nlos
        score = (residual**2 / (1.0 + spread[:, None] + doubt)).min(axis=1)
        excess = score / self._settings.outlier_std**2
        for row, scale, factor in zip(rows.rows, rows.scale, excess, strict=True):
            if factor > 1.0:
                self._rows[row, _WHITE] += scale**2 * (factor * factor - 1.0)
        return int((excess > 1.0).sum())

    def _forget(self) -> int:
        """When the history is full, drop every second window of each vehicle's older two thirds."""
        if self.windows <= self._settings.maximum_windows:
            return 0
        dropped = []
        for link in range(len(self._vehicles)):
            mine = np.flatnonzero(self._rows[:, _LINK] == link)
            dropped.append(mine[: 2 * mine.size // 3][1::2])
        drop = np.concatenate(dropped)
        if not drop.size:
            drop = np.arange(self.windows - self._settings.maximum_windows)
        keep = np.ones(self.windows, dtype=bool)
        keep[drop] = False
        self._relate(self._rows[keep])
        return int(drop.size)

    def _relate(self, rows: FloatArray) -> None:
        """Make ``rows`` the whole history, each related to those before it."""
        self._rows = np.zeros((0, _COLUMNS))
        self._parents = np.zeros((0, self._width), dtype=np.int64)
        self._weights = np.zeros(0)
        for row in rows:
            _, parents, weight = self._relatives(row)
            self._append(row, parents, weight)

    def _take(self, first: int) -> None:
        observations = self._observations()
        rows = whiten(observations, first, len(self._vehicles), self._settings.correlation_m, self._model)
        self._evidence.add(observations, rows, self._mesh.center_enu_m)
        self._evidence.angle_log += angle_log_likelihood(
            observations, first, self._mesh.center_enu_m, self._mesh.half_m, self._model
        )
        self._log_likelihood = self._evidence.log_likelihood(self._exponents, self._settings.noise_degrees)

    def _rebuild(self) -> None:
        """Lay the boxes anew and weigh the whole history on them."""
        observations = self._observations()
        links, shares = len(self._vehicles), len(self._model.los_shares)
        rows = whiten(observations, 0, links, self._settings.correlation_m, self._model)
        parts: list[Evidence] = []

        def evaluate(mesh: Mesh, _: IntArray) -> tuple[FloatArray, float]:
            part = Evidence.empty(mesh.count, links, shares)
            part.add(observations, rows, mesh.center_enu_m)
            part.angle_log += angle_log_likelihood(
                observations, 0, mesh.center_enu_m, mesh.half_m, self._model
            )
            parts.append(part)
            return part.log_likelihood(self._exponents, self._settings.noise_degrees), 1.0

        found = refine(self._area, evaluate, self._mesh_settings)
        self._mesh, self._log_likelihood = found.mesh, found.log_likelihood
        self._evidence = Evidence.gathered(parts, found.place)
        # Where the number of boxes is used up, laying them anew would not help until the belief moves.
        self._remesh_mass = max(self._settings.remesh_mass, 2.0 * self._heaviest())

    def _heaviest(self) -> float:
        """Mass of the heaviest box that can be split."""
        splittable = self._mesh.half_m[:, 0] > 2.0 * self._settings.minimum_half_m
        return float(np.where(splittable, self.mass, 0.0).max())

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values; ``restore`` continues bit for bit."""
        evidence = self._evidence
        return {
            "vehicles": list(self._vehicles),
            "rows": self._rows.copy(),
            "weights": self._weights.copy(),
            "parents": self._parents.copy(),
            "center_enu_m": self._mesh.center_enu_m.copy(),
            "half_m": self._mesh.half_m.copy(),
            "log_volume": self._mesh.log_volume.copy(),
            "log_likelihood": self._log_likelihood.copy(),
            "remesh_mass": self._remesh_mass,
            "count": evidence.count,
            "level_level": evidence.level_level,
            "level_loading": evidence.level_loading.copy(),
            "loading_loading": evidence.loading_loading.copy(),
            "level_path": evidence.level_path.copy(),
            "path_path": evidence.path_path.copy(),
            "loading_path": evidence.loading_path.copy(),
            "angle_log": evidence.angle_log.copy(),
        }

    @classmethod
    def restore(
        cls, tree: dict[str, Any], area: SearchArea, model: SignalModel, settings: TrackingSettings
    ) -> Belief:
        """A belief from what ``state`` gave."""
        belief = cls(area, model, settings)
        belief._vehicles = [int(vehicle) for vehicle in tree["vehicles"]]
        belief._rows = _array(tree["rows"]).reshape(-1, _COLUMNS)
        belief._weights = _array(tree["weights"])
        parents = np.array(tree["parents"], dtype=np.int64).reshape(belief.windows, -1)
        if belief.windows and parents.shape[1] != belief._width:
            # Kept with other settings: the windows are evidence still, their relations are not.
            belief._relate(belief._rows)
            belief._rebuild()
            return belief
        belief._parents = parents.reshape(-1, belief._width)
        belief._mesh = Mesh(_array(tree["center_enu_m"]), _array(tree["half_m"]), _array(tree["log_volume"]))
        belief._log_likelihood = _array(tree["log_likelihood"])
        belief._remesh_mass = float(tree["remesh_mass"])
        belief._evidence = Evidence(
            float(tree["level_level"]),
            _array(tree["level_loading"]),
            _array(tree["loading_loading"]),
            _array(tree["level_path"]),
            _array(tree["path_path"]),
            _array(tree["loading_path"]),
            _array(tree["angle_log"]),
            int(tree["count"]),
        )
        return belief


def _smallest(values: FloatArray, count: int) -> Any:
    """Indices of the ``count`` smallest values, in order; ties by index."""
    if values.size > 4 * count:
        limit = np.partition(values, count - 1)[count - 1]
        few = np.flatnonzero(values <= limit)
        return few[np.argsort(values[few], kind="stable")][:count]
    return np.argsort(values, kind="stable")[:count]


def _array(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64)
