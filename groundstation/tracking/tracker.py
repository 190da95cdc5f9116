"""What the service holds of one beacon: the belief of a still person and, beside it, of a walking one.

Exists so that nothing outside this room asks which of the two it is: places and masses are
those of the mixture. Rules: where walking is not believed, the answer is the still belief's
alone, bit for bit; and once it is certain that somebody walked, what was believed of a place
left behind pulls no more: the still belief is begun anew where the walker is by then, so that
one who has stopped is a still person again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from groundstation.localization.mesh import Mesh, joined
from groundstation.localization.problem import FloatArray, SearchArea, SignalModel
from groundstation.tracking.belief import Belief, Field, TrackObservation, Update
from groundstation.tracking.cloud import Cloud
from groundstation.tracking.settings import TrackingSettings
from groundstation.tracking.walking import Walk

_ABOUT_A_STILL_PERSON = ("prior", "silence")
"""Fields that say where somebody was who has not moved since."""
_ELSEWHERE = 0.02
"""Share of a belief begun anew that the walker's place does not bind."""


class Tracker:
    """See the module. ``seed`` (the beacon's id) and the windows decide every number."""

    def __init__(
        self, area: SearchArea, model: SignalModel, settings: TrackingSettings, seed: int = 0
    ) -> None:
        self._model, self._settings, self._seed = model, settings, seed
        self._still = Belief(area, model, settings)
        self._walk = Walk(area, self._still.model, settings, seed)
        self._waiting: list[TrackObservation] = []
        self._left: tuple[Cloud, float, float, float] | None = None
        """Where the still belief was begun anew, with which limits of power, and when."""
        self._mixture: tuple[Mesh, FloatArray] | None = None

    @property
    def still(self) -> Belief:
        """The belief of a still person; another one after somebody walked."""
        return self._still

    @property
    def walking_probability(self) -> float:
        """P(the person has been walking), 0 to 1."""
        return self._walk.probability

    @property
    def mesh(self) -> Mesh:
        """The candidate boxes; those of a walking person lie over those of a still one."""
        return self._mixed()[0]

    @property
    def mass(self) -> FloatArray:
        """(C,) share of the belief in each box of ``mesh``."""
        return self._mixed()[1]

    @property
    def area(self) -> SearchArea:
        """Where the target may be."""
        return self._still.area

    @property
    def windows(self) -> int:
        """Windows remembered; none of before the person is known to have moved."""
        return self._still.windows

    @property
    def vehicles(self) -> tuple[int, ...]:
        """Vehicles heard from, in order of their first window."""
        return self._walk.vehicles or self._still.vehicles

    @property
    def vehicle_variance_m2(self) -> tuple[float, float]:
        """What its vehicles' places leave unsure of the answer: each horizontal axis, and height, m²."""
        return self._still.vehicle_variance_m2

    def transmit_power_dbm(self) -> float:
        """Posterior mean at the most likely place."""
        if self._walk.probability >= 0.5:
            return self._walk.power()[0]
        return self._still.transmit_power_dbm()

    def set_area(self, area: SearchArea) -> None:
        """Take another search area; all remembered windows count there too."""
        self._still.set_area(area)
        self._walk.set_area(area, self._still)
        self._mixture = None

    def set_field(self, name: str, field: Field | None) -> None:
        """Further log likelihood of places (see ``Belief.set_field``), of somebody who has not moved.

        It reaches a walker by where his walk begins.
        """
        if self._left is None or name not in _ABOUT_A_STILL_PERSON:
            self._still.set_field(name, field)
            self._mixture = None

    def absorb(self, other: Tracker) -> None:
        """Take in all windows that ``other`` remembers, in the order of time; it stays as it is.

        Of somebody who walked only the newest whereabouts count: those of the one heard last.
        """
        if max(self.walking_probability, other.walking_probability) < 0.5 and not (self._left or other._left):
            self._still.absorb(other._still)
            if other._walk.time_s is not None and (self._walk.time_s or -math.inf) < other._walk.time_s:
                self._walk.restore(other._walk.state())
            self._walk.forget()
        elif (self._walk.time_s or -math.inf) < (other._walk.time_s or -math.inf):
            again = Tracker.restore(other.state(), self.area, self._model, self._settings, self._seed)
            self._still, self._walk, self._left = again._still, again._walk, again._left
            self._waiting = again._waiting
        self._mixture = None

    def update(self, batch: list[TrackObservation]) -> Update:
        """Take in windows, in order. One call a tick costs less than one a window."""
        told = self._still.update(batch)
        self._waiting += batch
        newest_s = max((window.time_s for window in self._waiting), default=0.0)
        if newest_s >= self._walk.due_s:
            self._walk.step(self._waiting, self._still)
            self._waiting = []
            self._leave_behind()
        self._mixture = None
        return told

    def rest(self) -> None:
        """Nothing comes for a while: free what only makes the next update cheaper. No number changes."""
        self._still.rest()

    def _mixed(self) -> tuple[Mesh, FloatArray]:
        walking = self._walk.probability
        if walking < self._settings.walking_shown:
            return self._still.mesh, self._still.mass
        if self._mixture is None:
            cloud, share = self._cloud().boxes()
            still, mass = self._still.mesh, self._still.mass
            self._mixture = joined([still, cloud]), np.concatenate([(1.0 - walking) * mass, walking * share])
        return self._mixture

    def _cloud(self) -> Cloud:
        return Cloud.of(self._walk.points.position_enu_m.T, self.area, self._settings.minimum_half_m)

    def _leave_behind(self) -> None:
        """Begin the still belief anew where the walker is, if he is sure to have left where it was."""
        settings, now_s = self._settings, self._walk.time_s
        if now_s is None or self._walk.probability < settings.walking_certain:
            return
        if self._left is not None and now_s - self._left[3] < settings.walking_restart_s:
            return
        power_dbm, spread_db = self._walk.power()
        # As wide as a uniform distribution of that spread, with some doubt.
        reach_db = 2.0 * spread_db + 1.0
        model = self._model
        self._begin_anew(
            self._cloud(),
            max(power_dbm - reach_db, model.transmit_power_min_dbm),
            min(power_dbm + reach_db, model.transmit_power_max_dbm),
            now_s,
        )
        self._walk.probability *= 1.0 - settings.walking_stopped
        self._walk.draw(self._still)

    def _begin_anew(self, cloud: Cloud, low_dbm: float, high_dbm: float, now_s: float) -> None:
        area, model = self.area, self._model
        if low_dbm < high_dbm:
            model = replace(model, transmit_power_min_dbm=low_dbm, transmit_power_max_dbm=high_dbm)
        self._still = Belief(area, model, self._settings)
        self._left = cloud, low_dbm, high_dbm, now_s
        self._bind()

    def _bind(self) -> None:
        assert self._left is not None
        cloud, area = self._left[0], self.area
        floor = _ELSEWHERE / (math.pi * area.radius_m**2)
        self._still.set_field("walked", lambda center, half: cloud.log_density(center, half, floor))

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values; ``restore`` continues bit for bit."""
        left = None
        if self._left is not None:
            cloud, *numbers = self._left
            left = {"cloud": cloud.state(), "numbers": numbers}
        return {
            "still": self._still.state(),
            "walk": self._walk.state(),
            "waiting": [[getattr(window, name) for name in _OBSERVED] for window in self._waiting],
            "left": left,
        }

    @classmethod
    def restore(
        cls,
        tree: dict[str, Any],
        area: SearchArea,
        model: SignalModel,
        settings: TrackingSettings,
        seed: int = 0,
    ) -> Tracker:
        """A tracker from what ``state`` gave."""
        tracker = cls(area, model, settings, seed)
        # Kept before there were walkers: the still belief alone.
        still = tree.get("still", tree)
        if tree.get("left") is not None:
            low_dbm, high_dbm, now_s = (float(value) for value in tree["left"]["numbers"])
            tracker._left = Cloud.restore(tree["left"]["cloud"]), low_dbm, high_dbm, now_s
            if low_dbm < high_dbm:
                model = replace(model, transmit_power_min_dbm=low_dbm, transmit_power_max_dbm=high_dbm)
        tracker._still = Belief.restore(still, area, model, settings)
        if tracker._left is not None:
            tracker._bind()
        if "walk" in tree:
            tracker._walk.restore(tree["walk"])
            tracker._waiting = [_observed(row) for row in tree["waiting"]]
        return tracker


_OBSERVED = tuple(TrackObservation.__slots__)


def _observed(row: Any) -> TrackObservation:
    # Rows kept by an earlier version are shorter.
    values = dict(zip(_OBSERVED, row, strict=False))
    values["position_enu_m"] = tuple(values["position_enu_m"])
    return TrackObservation(**values)
