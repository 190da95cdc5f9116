"""One beacon's belief: every window of every vehicle, fused where the person could be.

Exists because a snapshot in rubble cannot be better than about half the area's radius, and
movement can. Rules: every window comes in (none is silently lost: taken, redundant or
without content); consecutive windows of a vehicle are not independent evidence (the shared
likelihood conditions on the nearest earlier ones); the belief can be rebuilt from its
bounded ``history``, over another search area too; same inputs, same numbers.

A still person is assumed. The candidates are boxes (``localization.mesh``) that split where
the belief gathers; between splits an update costs a few products of arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundstation.localization.bearings import Bearings
from groundstation.localization.likelihood import ExponentGrid
from groundstation.localization.mesh import IntArray, Mesh, MeshSettings, masses
from groundstation.localization.problem import FloatArray, SearchArea, SignalModel
from groundstation.localization.regression import Evidence
from groundstation.localization.regressors import Regressors
from groundstation.localization.whitening import Observations, Whitened, whiten, whiten_rows
from groundstation.tracking.candidates import Candidates
from groundstation.tracking.history import History, TrackObservation, one_window_a_vehicle
from groundstation.tracking.settings import TrackingSettings

__all__ = ["Belief", "Field", "TrackObservation", "Update"]

Field = Callable[[FloatArray, FloatArray], FloatArray]
"""Log likelihood (C,) of boxes: centres (C, 3), half widths and heights (C, 2), metres ENU."""

_DEAR = 2.0
"""A box may hold so many times as much before boxes are laid anew where that means weighing all windows."""
_OF_PLACES = 0.25
"""Half the width of the smallest box, in the standard deviation of the vehicles' told places."""
_JUDGES = 64
"""Most likely places at which a power is judged."""


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
            angle_bias_std_rad=settings.angle_bias_std_rad,
            nlos_exponent_doubt=settings.nlos_exponent_doubt,
        )
        self._exponents = ExponentGrid.of(self._model)
        self._finest = MeshSettings(
            base_cells=settings.base_cells,
            maximum_cells=settings.maximum_cells,
            split_mass=settings.split_mass,
            minimum_half_m=settings.minimum_half_m,
        )
        self._area = area
        self._history = History(self._model, settings)
        self._boxes = Candidates(self._model, self._exponents, settings.noise_degrees)
        self._fields: dict[str, Field] = {}
        self._field_log: FloatArray | None = None
        self._held: tuple[FloatArray, FloatArray | None, FloatArray] | None = None
        """Masses, and of which log likelihoods they are."""
        self._remesh_mass = settings.remesh_mass
        self._whole = True
        """Whether the sums are those of the remembered windows, none forgotten among them."""
        self._unwatched = 0
        """Windows since the boxes that were let go were last looked at."""
        self._rebuild()

    @property
    def mesh(self) -> Mesh:
        """The candidate boxes."""
        self._renew_fields()
        return self._boxes.mesh

    @property
    def gone(self) -> Mesh:
        """The rest of the area: boxes that held nothing and were let go."""
        return self._boxes.gone

    @property
    def mass(self) -> FloatArray:
        """(C,) share of the belief in each box."""
        self._renew_fields()
        return self._masses().copy()

    @property
    def log_likelihood(self) -> FloatArray:
        """(C,) log of the belief's density in each box, up to a constant; fields included."""
        self._renew_fields()
        return self._total().copy()

    @property
    def area(self) -> SearchArea:
        """Where the target may be."""
        return self._area

    @property
    def windows(self) -> int:
        """Windows remembered."""
        return self._history.count

    @property
    def vehicles(self) -> tuple[int, ...]:
        """Vehicles heard from, in order of their first window."""
        return tuple(self._history.vehicles)

    @property
    def model(self) -> SignalModel:
        """The radio's model as the belief uses it."""
        return self._model

    @property
    def vehicle_variance_m2(self) -> tuple[float, float]:
        """What its vehicles' places leave unsure of the answer: each horizontal axis, and height, m²."""
        return self._history.vehicle_variance_m2()

    @property
    def settings(self) -> TrackingSettings:
        """What it was made with."""
        return self._settings

    @property
    def exponents(self) -> ExponentGrid:
        """Prior of the exponents."""
        return self._exponents

    @property
    def evidence(self) -> Evidence:
        """The running sums at the boxes of ``mesh``; to read."""
        self._renew_fields()
        return self._boxes.evidence

    @property
    def bearings(self) -> Bearings:
        """What is known of the vehicles' constant errors at the boxes of ``mesh``; to read."""
        self._renew_fields()
        return self._boxes.bearings

    @property
    def rows(self) -> FloatArray:
        """(n, columns) the windows remembered (``History.rows``), links as in ``vehicles``; to read."""
        return self._history.rows

    def observations(self) -> Observations:
        """The windows remembered; links are numbered as in ``vehicles``."""
        return self._history.related()

    def counts(self) -> dict[int, tuple[int, int, int]]:
        """Of each vehicle: windows taken, redundant, and taken with less weight as outliers."""
        history = self._history
        return {
            vehicle: (count.taken, count.redundant, count.outliers)
            for vehicle, count in zip(history.vehicles, history.counts, strict=True)
        }

    def transmit_power_dbm(self) -> float:
        """Posterior mean at the most likely place."""
        self._renew_fields()
        best = int(np.argmax(self._total()))
        nuisance = self._boxes.evidence.nuisances_at(best, *self._boxes.solved.means_at(best))
        return self._model.transmit_power_mean_dbm + self._model.transmit_power_std_db * float(nuisance[0])

    def set_area(self, area: SearchArea) -> None:
        """Take another search area; all remembered windows count there too."""
        self._area = area
        self._rebuild()

    def set_field(self, name: str, field: Field | None) -> None:
        """Add, exchange or (None) take away a log likelihood of places that no window states.

        ``field`` is called with boxes, see ``Field``, at each new layout, and must give the same
        numbers for the same boxes. Not part of ``state``: its owner sets it again.
        """
        if field is None:
            self._fields.pop(name, None)
        else:
            self._fields[name] = field
        # Worked out when next asked for: of several set in a row only the last sum matters.
        self._field_log = None

    def fields_at(self, mesh: Mesh) -> FloatArray:
        """(C,) log likelihood of boxes by all fields."""
        total = np.zeros(mesh.count)
        for name in sorted(self._fields):
            total += self._fields[name](mesh.center_enu_m, mesh.half_m)
        return total

    def _renew_fields(self) -> None:
        if self._field_log is None:
            self._field_log = self.fields_at(self._boxes.mesh)
            if self._is_coarse():
                self._rebuild(self._whole)

    def _total(self) -> FloatArray:
        told = self._boxes.log_likelihood
        return told if self._field_log is None else told + self._field_log

    def _masses(self) -> FloatArray:
        """(C,) share of the belief in each box, as fields and windows stand; to read."""
        told, otherwise = self._boxes.log_likelihood, self._field_log
        # Asked for several times between two updates.
        if self._held is None or self._held[0] is not told or self._held[1] is not otherwise:
            self._held = told, otherwise, masses(self._total(), self._boxes.mesh)
        return self._held[2]

    def update(self, batch: list[TrackObservation]) -> Update:
        """Take in windows, in order. One call a tick costs less than one a window."""
        self._renew_fields()
        first = self.windows
        empty = outliers = offered = 0
        powers: list[tuple[Whitened, Regressors]] = []
        for group in one_window_a_vehicle(batch):
            # A vehicle's next window is judged against this one: this one is judged first.
            found = [self._history.row(window) for window in group]
            rows = [row for row in found if row is not None]
            empty += len(found) - len(rows)
            offered += len(rows)
            before = self.windows
            if rows and self._history.take(np.array(rows)):
                count, judged = self._weigh_down_outliers(before)
                outliers += count
                powers.append(judged)
        taken = self.windows - first
        redundant = offered - taken
        if taken == 0:
            return Update(0, redundant, empty, 0, 0)
        self._boxes.take(self._history.observations(), first, powers, len(self._history.vehicles))
        # What is forgotten stays in the sums until boxes have to be laid anew.
        forgotten = self._history.forget()
        if forgotten.size:
            self._whole = False
            self._boxes.forget(forgotten)
        self._unwatched += taken
        if self._is_coarse() or self._found_again():
            self._rebuild(self._whole)
        else:
            self._let_go()
        return Update(taken, redundant, empty, outliers, forgotten.size)

    def rest(self) -> None:
        """Nothing comes for a while: free the megabytes that only make the next update cheaper."""
        self._boxes.rest()

    def absorb(self, other: Belief) -> None:
        """Take in all that another belief remembers: both were one phone. ``other`` stays as it is."""
        self._history.absorb(other._history)
        self._rebuild()

    def _whiten(self, first: int) -> tuple[Observations, Whitened]:
        observations = self._history.observations()
        links = len(self._history.vehicles)
        return observations, whiten(observations, first, links, self._settings.correlation_m, self._model)

    def _regressed(self, first: int) -> tuple[Whitened, Regressors]:
        """The powers from row ``first`` on, and their regressors at the boxes."""
        observations, rows = self._whiten(first)
        return rows, self._boxes.regressors(observations, rows)

    def _weigh_down_outliers(self, first: int) -> tuple[int, tuple[Whitened, Regressors]]:
        """Widen what is implausible at every likely place (Huber's weight, once, on arrival): how many, and
        the powers then, as ``_regressed`` gives them."""
        self._boxes.grow(len(self._history.vehicles))
        powers = rows, regressors = self._regressed(first)
        if not rows.rows.size:
            return 0, powers
        boxes = self._boxes
        mass = self._masses()
        likely = np.flatnonzero(mass > 1e-3 * mass.max())
        likely = likely[np.argsort(-mass[likely], kind="stable")[:_JUDGES]]
        right = boxes.evidence.level_loading[:, None].repeat(likely.size, axis=1)
        residual = rows.level[:, None].repeat(likely.size, axis=1)
        # Exponents are taken at the best place only: half a unit of doubt in them is allowed for.
        variance = np.ones_like(residual)
        orders = boxes.solved.means_at(int(np.argmax(mass)))
        doubts = 0.0, 0.25, self._model.antenna_null_std**2
        for number, (order, doubt, regressor) in enumerate(zip(orders, doubts, regressors, strict=True)):
            right += order * boxes.evidence.loading_path[number].take(likely, axis=1)
            if regressor is not None:
                loss = regressor.take(likely, axis=1)
                residual += order * loss
                variance += doubt * loss**2
        # What foretells power and offsets, and how well they are known.
        whitener = boxes.solved.whitener
        known = whitener @ rows.loading.T
        residual -= known.T @ (whitener @ right)
        variance += np.square(known).sum(axis=0)[:, None]
        excess = (residual**2 / variance).min(axis=1) / self._settings.outlier_std**2
        strange = excess > 1.0
        if not strange.any():
            return 0, powers
        self._history.widen(rows.rows[strange], np.square(rows.scale[strange]) * (excess[strange] ** 2 - 1.0))
        return int(strange.sum()), self._regressed(first)

    def _let_go(self) -> None:
        kept = self._boxes.let_go(self._total())
        if kept is not None and self._field_log is not None:
            self._field_log = self._field_log[kept]

    def _found_again(self) -> bool:
        """Whether the belief has to be laid anew where nothing was to be found; asked now and then."""
        if not self._boxes.gone.count or self._unwatched < self._settings.maximum_windows // 2:
            return False
        self._unwatched = 0
        links = len(self._history.vehicles)
        return self._boxes.found_again(self._total(), self.windows, self._remembered, links, self.fields_at)

    def _remembered(self, some: IntArray) -> tuple[Observations, Whitened]:
        """The windows remembered; of them ``some``, numbers that rise, related, and their powers whitened."""
        if some.size == self.windows:
            self._history.relate_again()
            return self._whiten(0)
        observations = self._history.related_some(some)
        rows = some[np.isfinite(observations.rss_dbm[some])]
        links = len(self._history.vehicles)
        return observations, whiten_rows(observations, rows, links, self._settings.correlation_m, self._model)

    def _rebuild(self, reuse: bool = False) -> None:
        """Lay the boxes anew and weigh the whole history on them.

        ``reuse``: boxes that were there before keep their sums, for the windows are the same.
        """
        self._history.relate_again()
        observations, rows = self._whiten(0)
        finest, links = self._mesh_settings(), len(self._history.vehicles)
        self._field_log = self._boxes.lay(
            self._area, finest, observations, rows, links, self.fields_at, reuse
        )
        self._unwatched = 0
        self._whole = True
        # Where the number of boxes is used up, laying them anew would not help until the belief moves.
        self._remesh_mass = max(self._settings.remesh_mass, 2.0 * self._heaviest())

    def _is_coarse(self) -> bool:
        """Whether a box holds so much that finer ones are worth their cost."""
        return self._heaviest() > self._remesh_mass * (1.0 if self._whole else _DEAR)

    def _mesh_settings(self) -> MeshSettings:
        # Finer than the vehicles know where they are nothing is to be told.
        of_places_m = _OF_PLACES * math.sqrt(self.vehicle_variance_m2[0])
        return replace(self._finest, minimum_half_m=max(self._finest.minimum_half_m, of_places_m))

    def _heaviest(self) -> float:
        """Mass of the heaviest box that can be split."""
        splittable = self._boxes.mesh.half_m[:, 0] > 2.0 * self._mesh_settings().minimum_half_m
        return float(np.where(splittable, self._masses(), 0.0).max())

    def state(self) -> dict[str, Any]:
        """Everything but the fields, as arrays and plain values; ``restore`` continues bit for bit
        once the fields are set again."""
        self._renew_fields()
        return {
            **self._history.state(),
            **self._boxes.state(),
            "remesh_mass": self._remesh_mass,
            "whole": self._whole,
            "unwatched": self._unwatched,
        }

    @classmethod
    def restore(
        cls, tree: dict[str, Any], area: SearchArea, model: SignalModel, settings: TrackingSettings
    ) -> Belief:
        """A belief from what ``state`` gave; kept with other settings, its windows are weighed anew."""
        belief = cls(area, model, settings)
        if not belief._history.restore(tree) or "bias_mean" not in tree:
            belief._rebuild()
            return belief
        belief._boxes.restore(tree)
        belief._field_log = None
        belief._remesh_mass = float(tree["remesh_mass"])
        belief._whole = bool(tree["whole"])
        belief._unwatched = int(tree.get("unwatched", 0))
        return belief
