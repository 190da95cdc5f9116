"""Who listened where, and what of it counts against a place: one beacon's silences.

Exists because that nobody heard a beacon is evidence only if it spoke, somebody listened and
would have heard it. Rules:

* A silence counts for sure where the beacon spoke in that interval: another vehicle heard it.
* What nobody heard counts only as far as the beacon is known to speak all the time: it was
  heard again whenever a vehicle that heard it well went on listening. One stop that was seen,
  and such silences count no more: a beacon that speaks now and then is not absent.
* Silences from before it was first heard count less again: it may have been switched on later.
* Places are thinned (``places``): hovering, or passing twice, is one silence.

What a silence then says of a place is ``detection``'s business.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.tracking.detection import SilenceField, shares, softness_db
from groundstation.tracking.places import EAST, SUMS, VEHICLE, Places
from groundstation.tracking.receivers import Receivers
from groundstation.tracking.settings import TrackingSettings

_BEFORE_S, _SINCE_S, _SPOKEN, _HEARD = range(SUMS, SUMS + 4)
_LEVEL, _LOS, _COUNT = range(SUMS, SUMS + 3)
_SEVERAL = 3.0
"""So many packets must have been sent before their absence is a silence."""
_STAYED_M = 60.0
"""A vehicle that moved less between two intervals would have heard again what it heard well."""
_GAP_S = 1.0
_LEAST_MISSED = 0.02


@dataclass(frozen=True, slots=True)
class Ear:
    """One vehicle in one interval, as one beacon sees it."""

    vehicle_id: int
    position_enu_m: tuple[float, float, float]
    packets: int
    """Of the beacon, heard in the interval."""


class Silence:
    """Silences of one beacon. Times are station seconds, places metres ENU."""

    def __init__(self, settings: TrackingSettings) -> None:
        self._settings = settings
        self._places = Places(4, settings.silence_spacing_m, settings.maximum_silent_places)
        self._levels = Places(3, settings.silence_spacing_m, settings.maximum_heard_places)
        self._spoken_packets = 0.0
        self._spoken_s = 0.0
        self._received = 0
        self._missed = 0
        self._goes = 0
        self._stops = 0
        self._strong: dict[int, tuple[float, ...]] = {}
        self._end_s = -math.inf
        self.changed = False
        """Whether anything came since the caller last made a field; the caller sets False."""

    def before(self, vehicle_id: int, position_enu_m: Sequence[float], seconds: float) -> None:
        """A vehicle listened so long at a place, and the beacon was not heard by anybody yet."""
        self._places.add(vehicle_id, position_enu_m, (seconds, 0.0, 0.0, 0.0))

    def listen(self, start_s: float, end_s: float, ears: Sequence[Ear], strong: Collection[int]) -> None:
        """One interval. ``strong``: vehicles whose newest window of it was well above their limit."""
        spoken = max((ear.packets for ear in ears), default=0)
        seconds = end_s - start_s
        if spoken:
            self._spoken_packets += spoken
            self._spoken_s += seconds
        if start_s - self._end_s > _GAP_S:
            self._strong = {}
        stayed = [
            ear
            for ear in ears
            if ear.vehicle_id in self._strong
            and math.dist(ear.position_enu_m, self._strong[ear.vehicle_id]) < _STAYED_M
        ]
        if stayed and spoken:
            self._goes += 1
        elif stayed:
            self._stops += 1
        self._end_s = end_s
        self._strong = {
            ear.vehicle_id: ear.position_enu_m for ear in ears if ear.packets and ear.vehicle_id in strong
        }
        for ear in ears:
            since_s = 0.0 if spoken else seconds
            self._places.add(ear.vehicle_id, ear.position_enu_m, (0.0, since_s, spoken, ear.packets))
        self.changed |= bool(ears)

    def heard(
        self,
        vehicle_id: int,
        position_enu_m: Iterable[float],
        rss_dbm: float | None,
        los_probability: float,
        packets: tuple[int, int],
    ) -> None:
        """A window of this beacon; ``packets``: received and missed."""
        self._received += packets[0]
        self._missed += packets[1]
        if rss_dbm is not None and math.isfinite(rss_dbm):
            self._levels.add(vehicle_id, tuple(position_enu_m), (rss_dbm, los_probability, 1.0))
            self.changed = True

    @property
    def quiet_probability(self) -> float:
        """P(it does not speak all the time, so that what nobody heard says nothing)."""
        if self._stops:
            return 1.0
        return max(self._settings.quiet_probability, 1.0 / (self._goes + 2.0))

    @property
    def loss_probability(self) -> float:
        """P(a packet is lost though its level is enough), from the beacon's own counter."""
        return min((self._missed + 0.5) / (self._missed + self._received + 2.0), 0.95)

    def field(self, receivers: Receivers, model: SignalModel) -> SilenceField | None:
        """What the silences say of places; None while they say nothing."""
        settings, rows, levels = self._settings, self._places.rows, self._levels.rows
        if not len(levels):
            return None
        cases, missed = self._cases()
        sensitivity = np.array(
            [
                math.nan if level is None else level
                for level in (receivers.sensitivity_dbm(int(row[VEHICLE])) for row in rows)
            ]
        )
        counts = np.flatnonzero(
            (rows[:, _HEARD] == 0.0) & np.isfinite(sensitivity) & (missed[cases > 0.0] < 1.0).any(axis=0)
        )
        if not counts.size:
            return None
        share = shares(rows[:, EAST:SUMS], rows[:, VEHICLE], settings.correlation_m, model.shared_shadowing)[
            counts
        ]
        vehicles = list(dict.fromkeys(int(vehicle) for vehicle in rows[counts, VEHICLE]))
        doubt = [
            settings.deaf_probability if receivers.proven(vehicle) else settings.unproven_deaf_probability
            for vehicle in vehicles
        ]
        los = levels[:, _LOS] / levels[:, _COUNT]
        variance = los * model.rss_std_db**2 + (1.0 - los) * (
            model.nlos_rss_std_db**2 + model.nlos_bias_max_db**2 / 12.0
        )
        variance += model.receiver_offset_std_db**2
        own = shares(levels[:, EAST:SUMS], levels[:, VEHICLE], settings.correlation_m, model.shared_shadowing)
        bias_db = 0.5 * model.nlos_bias_max_db
        level = levels[:, _LEVEL] / levels[:, _COUNT] - model.transmit_power_mean_dbm
        return SilenceField(
            heard_enu_m=levels[:, EAST:SUMS].copy(),
            level_dbm=level + (1.0 - los) * bias_db - model.receiver_offset_db,
            heard_los=los,
            heard_precision=own / variance,
            silent_enu_m=rows[counts, EAST:SUMS],
            receiver=np.array([vehicles.index(int(v)) for v in rows[counts, VEHICLE]], dtype=np.int64),
            sensitivity_dbm=sensitivity[counts] - model.receiver_offset_db,
            missed=missed[:, counts],
            cases=cases,
            share=share,
            deaf=np.array(doubt),
            power_mean_dbm=model.transmit_power_mean_dbm,
            power_std_db=model.transmit_power_std_db,
            los_exponent=model.los_exponent,
            exponent_mean=0.5 * (model.nlos_exponent_min + model.nlos_exponent_max),
            exponent_std=(model.nlos_exponent_max - model.nlos_exponent_min) / math.sqrt(12.0),
            bias_db=bias_db,
            softness_db=softness_db(model, settings.sensitivity_std_db),
            doubt=settings.silence_doubt,
            null_mean=model.antenna_null_mean,
            null_std=model.antenna_null_std,
        )

    def _cases(self) -> tuple[FloatArray, FloatArray]:
        """(3,) probabilities of: it spoke when heard, since first heard, always; (3, n) P(missed) in each."""
        rows, loss = self._places.rows, self.loss_probability
        rate = self._spoken_packets / self._spoken_s if self._spoken_s else 0.0

        def several(seconds: FloatArray) -> FloatArray:
            sent = rate * seconds
            return np.where(sent >= _SEVERAL, sent, 0.0)

        known = loss ** rows[:, _SPOKEN]
        since = known * np.exp(-several(rows[:, _SINCE_S]) * (1.0 - loss))
        always = since * np.exp(-several(rows[:, _BEFORE_S]) * (1.0 - loss))
        missed = np.stack([known, since, always])
        missed = np.where(missed < 1.0, _LEAST_MISSED + (1.0 - _LEAST_MISSED) * missed, 1.0)
        quiet, later = self.quiet_probability, self._settings.switched_on_later_probability
        cases = np.array([quiet, (1.0 - quiet) * later, (1.0 - quiet) * (1.0 - later)])
        # Cases that say the same are one.
        for more, less in ((2, 1), (1, 0)):
            if not np.any(missed[more] < missed[less]):
                cases[less] += cases[more]
                cases[more] = 0.0
        return cases, missed

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values."""
        return {
            "places": self._places.state(),
            "levels": self._levels.state(),
            "counts": [
                self._spoken_packets, self._spoken_s, self._received, self._missed, self._goes, self._stops
            ],
            "strong": [[vehicle, list(place)] for vehicle, place in self._strong.items()],
            "end_s": None if math.isinf(self._end_s) else self._end_s,
            "changed": self.changed,
        }  # fmt: skip

    def restore(self, tree: Mapping[str, Any]) -> None:
        """Take back what ``state`` gave."""
        self._places.restore(tree["places"])
        self._levels.restore(tree["levels"])
        packets, seconds, received, missed, goes, stops = tree["counts"]
        self._spoken_packets, self._spoken_s = float(packets), float(seconds)
        self._received, self._missed = int(received), int(missed)
        self._goes, self._stops = int(goes), int(stops)
        self._strong = {int(v): tuple(float(x) for x in place) for v, place in tree["strong"]}
        self._end_s = -math.inf if tree["end_s"] is None else float(tree["end_s"])
        self.changed = bool(tree["changed"])
