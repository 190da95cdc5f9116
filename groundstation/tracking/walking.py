"""A person who walks: particles of place and speed, everything else in closed form.

Exists because one place for all windows is wrong for somebody on foot, and forgetting old
windows for everybody would cost the still person, who is the rule. Rules: walking is weighed
against standing still by how well each foretells the next windows, both scored alike; a walk
begins where the still belief is at that moment; nothing is drawn but from a generator keyed
by the beacon and counted by the step.

Rao–Blackwellised (Doucet et al., 2000): a particle holds place, velocity and exponents; transmit
power and the vehicles' offsets are Gaussian given these, with a covariance that is the same for
all, so that one Kalman gain serves all; the vehicles' errors of bearing are followed as ``bearings``
does at the still belief's boxes. How all this changes with time is in ``walking_motion``.

What tells most of whether somebody walks, by power alone, is a vehicle that comes again to where it has
been: standing still foretells its levels from those of then (``walking_windows.visits``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundstation.localization.bearings import Bearings
from groundstation.localization.mesh import Mesh
from groundstation.localization.problem import FloatArray, SearchArea, SignalModel
from groundstation.tracking.belief import Belief
from groundstation.tracking.history import LINK, History, TrackObservation
from groundstation.tracking.settings import TrackingSettings
from groundstation.tracking.walking_motion import drifted, moved, sent_off
from groundstation.tracking.walking_points import Points, drawn, grown_covariance, losses_db, systematic
from groundstation.tracking.walking_windows import Related, Windows, latest, newest, related, visits

_DEGREES = 20.0
"""Of the Student-t that a window is scored with: one window does not decide who walks."""
_NOISE_DEGREES = 12.0
"""How firmly the model's noise level is believed."""
_SCATTER_ROWS = 400
_NOT_REPEATED = 0.1
"""P(a level does not repeat itself where a vehicle comes again, though nobody moved)."""
_KERNEL_M = 1.0
"""Half the width of the box that a particle stands for."""
_PACE_MPS = 0.8
_MOMENT_S = 0.5
"""Bearings are met with the person where he was, to so many seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """What windows say of points."""

    power_log: FloatArray
    """(r, N) log density of each power, given the past and those before it."""
    angles_log: FloatArray
    """(N,) of the bearings."""
    points: Points
    """After them."""
    covariance: FloatArray
    """(1 + V, 1 + V) after them."""
    misfit: FloatArray
    """(r,) least squared innovation at any point, in variances."""
    typical: FloatArray
    """(r,) the points' median of it."""

    def or_else(self, plain: Scored) -> Scored:
        """This, but for each window the doubt that nothing but ``plain`` holds of it."""
        log = np.logaddexp(
            self.power_log + math.log1p(-_NOT_REPEATED), plain.power_log + math.log(_NOT_REPEATED)
        )
        misfit, typical = np.minimum(self.misfit, plain.misfit), np.minimum(self.typical, plain.typical)
        return replace(self, power_log=log, misfit=misfit, typical=typical)

    @property
    def log_density(self) -> FloatArray:
        """(N,) of the windows, given the past."""
        result: FloatArray = self.power_log.sum(axis=0) + self.angles_log
        return result


class Walk:
    """See the module."""

    def __init__(
        self, area: SearchArea, model: SignalModel, settings: TrackingSettings, seed: int = 0
    ) -> None:
        self._area, self._model, self._settings, self._seed = area, model, settings, seed
        self._numbers = History(model, settings)
        self._past = Windows(np.zeros((0, 1)), np.zeros(0))
        self._steps = 0
        self._points = Points.none(0, model)
        self._covariance: FloatArray = np.eye(1)
        self._still = Points.none(0, model)
        self._still_weight: FloatArray = np.zeros(0)
        self._still_covariance: FloatArray = np.eye(1)
        self._drawn_s = -math.inf
        self._scatter = (0.0, 0.0)
        """Sum of squared innovations in variances, of the better of the two, and their number."""
        self.time_s: float | None = None
        """Station time of the last step; None: no window yet."""
        self.probability = 0.0
        """P(walking)."""

    @property
    def possible(self) -> bool:
        """Whether anybody may walk at all."""
        return self._settings.walking_prior > 0.0 or self._settings.walking_rate_per_s > 0.0

    @property
    def _suspected(self) -> bool:
        return self.probability > self._settings.walking_suspected

    @property
    def _particles(self) -> int:
        settings = self._settings
        return settings.walking_particles if self._suspected else settings.walking_watch_particles

    @property
    def due_s(self) -> float:
        """When the next step is due, station seconds: sooner where walking is suspected."""
        settings = self._settings
        wait_s = settings.walking_interval_s if self._suspected else settings.walking_watch_interval_s
        return -math.inf if self.time_s is None else self.time_s + wait_s

    @property
    def vehicles(self) -> tuple[int, ...]:
        """Vehicles heard from, in order of their first window."""
        return tuple(self._numbers.vehicles)

    @property
    def points(self) -> Points:
        """The walker's particles, equally likely."""
        return self._points

    def step(self, windows: list[TrackObservation], belief: Belief) -> None:
        """Take in the windows since the last step; ``belief`` has taken them in already.

        What it had said before them was drawn then.
        """
        # Two seconds hardly change what is heard: one window a vehicle says nearly as much as all.
        new = Windows.of(latest(windows), self._numbers)
        if new.count == 0 or not self.possible:
            return
        new = new.take(self._watched(new))
        links = len(self._numbers.vehicles)
        rng = np.random.Generator(np.random.Philox(key=[self._seed % 2**64, self._steps]))
        self._steps += 1
        now_s = float(new.time_s.max())
        if self.time_s is not None:
            now_s = max(now_s, self.time_s)
            self._advance(new, self._visited(new, belief), now_s - self.time_s, links, rng)
        self.time_s = now_s
        self._past = newest(self._past.then(new), links)
        if now_s - self._drawn_s >= self._settings.walking_redraw_s:
            # Between draws the places are weighed by the windows, as the walker's are.
            self.draw(belief, rng)

    def _watched(self, new: Windows) -> Any:
        """Which of the windows, one a vehicle, are worth their cost: not all, and each in its turn."""
        most = self._settings.walking_watch_vehicles
        if self._suspected or new.count <= most or not self._past.count:
            return np.arange(new.count)
        # Of every vehicle there is one to begin with.
        known = set(self._past.rows[:, LINK].tolist())
        chosen = np.array([link not in known for link in new.rows[:, LINK].tolist()])
        chosen[(self._steps * most + np.arange(most)) % new.count] = True
        return np.flatnonzero(chosen)

    def _visited(self, new: Windows, belief: Belief) -> Windows:
        """What was heard earlier from where ``new`` was, by all that the still belief remembers."""
        known = self._numbers.vehicles
        links = [known.index(vehicle) if vehicle in known else -1 for vehicle in belief.vehicles]
        numbers = np.array(links, dtype=np.int64)
        return visits(belief.rows, numbers, self._past, new, self._settings.correlation_m)

    def draw(self, belief: Belief, rng: np.random.Generator | None = None) -> None:
        """Take the still belief as it is now for what stillness foretells from here on."""
        if rng is None:
            rng = np.random.Generator(np.random.Philox(key=[self._seed % 2**64, self._steps]))
            self._steps += 1
        count = self._settings.walking_points
        place = self._past.observations().position_enu_m
        vehicles = self._numbers.vehicles
        self._still, self._still_covariance = drawn(belief, self._model, vehicles, place, count, rng)
        self._still = self._still.settled()
        self._still_weight = np.full(count, 1.0 / count)
        self._drawn_s = -math.inf if self.time_s is None else self.time_s

    def set_area(self, area: SearchArea, belief: Belief) -> None:
        """Take another search area: whoever is outside it is not there; with nobody left, nobody walks."""
        self._area = area
        inside = np.flatnonzero(area.contains(self._points.position_enu_m[0], self._points.position_enu_m[1]))
        if inside.size:
            chosen = inside[np.arange(self._points.count) % inside.size]
            self._points = self._points.take(chosen)
            height = self._points.position_enu_m[2]
            np.clip(height, area.height_min_m, area.height_max_m, out=height)
        else:
            self.forget()
        if self.time_s is not None:
            self.draw(belief)

    def forget(self) -> None:
        """Nobody walks."""
        self._points, self.probability = Points.none(len(self._numbers.vehicles), self._model), 0.0

    def _advance(
        self, new: Windows, again: Windows, elapsed_s: float, links: int, rng: np.random.Generator
    ) -> None:
        settings, model = self._settings, self._model
        still = self._still.grown(links, model)
        self._still_covariance = grown_covariance(self._still_covariance, links)
        first = self._points.count == 0
        if first and (elapsed_s <= 0.0 or links < settings.walking_vehicles):
            share = 0.0
        elif first:
            self._covariance, share = self._still_covariance, settings.walking_prior
        else:
            share = -math.expm1(-elapsed_s * settings.walking_rate_per_s)
        self._covariance = grown_covariance(self._covariance, links)
        standing_log, walking_log = math.log(max(1.0 - self.probability, 1e-300)), -math.inf
        points, weight = self._points.grown(links, model), np.zeros(0)
        if share > 0.0:
            # Whoever starts to walk now starts where the still belief is.
            births = self._particles if first else settings.walking_births
            born = sent_off(still.take(systematic(self._still_weight, births, rng)), settings, rng)
            starting = (1.0 - self.probability) * share
            points = moved(Points.joined(points, born), elapsed_s, self._area, model, settings, rng)
            points, self._covariance = drifted(points, self._covariance, elapsed_s, model)
            old = self._points.count
            weight = np.concatenate(
                [np.full(old, self.probability / max(old, 1)), np.full(births, starting / births)]
            )
            standing_log += math.log1p(-share)
        moving, standing = self._scored_both(points, still, new, again, links, elapsed_s)
        staying = self._still_weight * np.exp(standing.log_density - standing.log_density.max())
        better = standing.typical if moving is None else np.minimum(standing.typical, moving.typical)
        keep = 1.0 if self._scatter[1] < _SCATTER_ROWS else 0.5
        self._scatter = keep * self._scatter[0] + float(better.sum()), keep * self._scatter[1] + better.size
        standing_log += float(np.log(staying.sum()) + standing.log_density.max())
        self._still, self._still_covariance = standing.points.settled(), standing.covariance
        self._still_weight = staying / staying.sum()
        if moving is None:
            return
        top = float(moving.log_density.max())
        weight *= np.exp(moving.log_density - top)
        walking_log = math.log(max(float(weight.sum()), 1e-300)) + top
        self.probability = 1.0 / (1.0 + math.exp(min(standing_log - walking_log, 700.0)))
        self._covariance = moving.covariance
        self._points = moving.points.take(systematic(weight, self._particles, rng)).settled()

    def power(self) -> tuple[float, float]:
        """Mean (dBm) and standard deviation (dB) of the transmit power, were the person walking."""
        model, each = self._model, self._points.nuisance[0]
        spread = model.transmit_power_std_db * math.sqrt(float(each.var()) + float(self._covariance[0, 0]))
        return model.transmit_power_mean_dbm + model.transmit_power_std_db * float(each.mean()), spread

    def state(self) -> dict[str, Any]:
        """Everything, as arrays and plain values; ``restore`` continues bit for bit."""
        return {
            "vehicles": list(self._numbers.vehicles),
            "past_rows": self._past.rows.copy(),
            "past_time_s": self._past.time_s.copy(),
            "steps": self._steps,
            "points": self._points.state(),
            "covariance": self._covariance.copy(),
            "still": self._still.state(),
            "still_weight": self._still_weight.copy(),
            "still_covariance": self._still_covariance.copy(),
            "drawn_s": None if math.isinf(self._drawn_s) else self._drawn_s,
            "time_s": self.time_s,
            "probability": self.probability,
            "scatter": list(self._scatter),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what ``state`` gave."""
        self._numbers = History(self._model, self._settings)
        self._numbers.vehicles = [int(vehicle) for vehicle in tree["vehicles"]]
        times = np.array(tree["past_time_s"], dtype=np.float64)
        self._past = Windows(np.array(tree["past_rows"], dtype=np.float64).reshape(times.size, -1), times)
        self._steps = int(tree["steps"])
        self._points, self._still = Points.restore(tree["points"]), Points.restore(tree["still"])
        self._covariance = np.array(tree["covariance"], dtype=np.float64)
        self._still_weight = np.array(tree["still_weight"], dtype=np.float64)
        self._still_covariance = np.array(tree["still_covariance"], dtype=np.float64)
        self._drawn_s = -math.inf if tree["drawn_s"] is None else float(tree["drawn_s"])
        self.time_s = None if tree["time_s"] is None else float(tree["time_s"])
        self.probability = float(tree["probability"])
        self._scatter = float(tree["scatter"][0]), float(tree["scatter"][1])

    def _scored_both(
        self, walkers: Points, still: Points, new: Windows, again: Windows, links: int, elapsed_s: float
    ) -> tuple[Scored | None, Scored]:
        count, moving = still.count, None
        both = Points.joined(still, walkers)
        for last in (False, True):
            # The same rows for both, or the one that is told to expect less would seem to foretell more;
            # only what was heard from here on an earlier visit is foretold by standing still alone.
            rows = related(self._past, new, links, _PACE_MPS, self._model, self._settings)
            if not last:
                # A window of a moment ago was heard from where the person was then.
                late_s = np.minimum(rows.late_s, elapsed_s)
                both, angles = self._bearings_met(both, rows, late_s)
                both, loss = self._losses_met(both, rows, late_s)
                met, gone = both.part(slice(count)), both.part(slice(count, None))
            standing = self._scored(met, loss[..., :count], angles[:count], self._still_covariance, rows)
            if again.count:
                expected = related(self._past, new, links, _PACE_MPS, self._model, self._settings, again)
                _, before = self._losses_met(still, expected, late_s)
                better = self._scored(met, before, angles[:count], self._still_covariance, expected)
                standing = better.or_else(standing)
            misfit, scale = standing.misfit, rows.whitened.scale
            if walkers.count:
                moving = self._scored(gone, loss[..., count:], angles[count:], self._covariance, rows)
                misfit = np.minimum(misfit, moving.misfit)
            far = misfit > self._settings.outlier_std**2
            if last or not far.any():
                break
            # What neither can explain is an outlier: its noise is widened (Huber's weight).
            excess = misfit[far] / self._settings.outlier_std**2
            new = new.widened(rows.whitened.rows[far] - rows.first, scale[far] ** 2 * (excess**2 - 1.0))
        return moving, standing

    def _losses_met(self, points: Points, rows: Related, late_s: FloatArray) -> tuple[Points, FloatArray]:
        """The points with the new windows' losses as the newest, and the losses (2, every window, N)."""
        offset = points.position_enu_m[:, None] - rows.every.position_enu_m[rows.past :].T[:, :, None]
        offset[:2, rows.first - rows.past :] -= late_s[:, None] * points.velocity_mps[:, None]
        loss = losses_db(offset, self._model.has_antenna_null)
        loss = np.concatenate([points.past_db[:, : rows.past], loss], axis=1)
        past_db = points.past_db.copy()
        past_db[:, rows.every.link[rows.first :]] = loss[:, rows.first :]
        return replace(points, past_db=past_db), loss

    def _scored(
        self, points: Points, loss: FloatArray, angles: FloatArray, covariance: FloatArray, rows: Related
    ) -> Scored:
        """The powers of ``rows`` weighed; ``loss`` and log density of ``angles`` as the points met them."""
        white = rows.whitened
        if not white.rows.size:
            return Scored(np.zeros((0, points.count)), angles, points, covariance, np.zeros(0), np.zeros(0))
        p = rows.every.los_probability[rows.family]
        error = white.level[:, None] - white.loading @ points.nuisance
        for order, mixing, kind in ((0, p, 0), (1, 1.0 - p, 0), (2, np.ones_like(p), 1)):
            if mixing.any() and points.orders[order].any():
                regressor = np.einsum("rm,rmn->rn", white.mixing * mixing, loss[kind][rows.family])
                error += points.orders[order] * regressor
        toward = covariance @ white.loading.T
        factor = np.linalg.cholesky(np.eye(white.rows.size) + white.loading @ toward)
        error = np.linalg.solve(factor, error)
        square = np.square(error)
        # Where the powers scatter more than the model says, they decide less between the two.
        noise = max((_NOISE_DEGREES + self._scatter[0]) / (_NOISE_DEGREES + self._scatter[1]), 1.0)
        density = -0.5 * (_DEGREES + 1.0) * np.log1p(square / (noise * _DEGREES))
        density -= (np.log(np.diag(factor)) + np.log(white.scale))[:, None]
        gain = np.linalg.solve(factor, toward.T)
        return Scored(
            density,
            angles,
            replace(points, nuisance=points.nuisance + gain.T @ error),
            covariance - gain.T @ gain,
            square.min(axis=1),
            _medians(square),
        )

    def _bearings_met(self, points: Points, rows: Related, late_s: FloatArray) -> tuple[Points, FloatArray]:
        """The points after the new bearings, and these bearings' log density (N,)."""
        told = np.flatnonzero(np.isfinite(rows.every.azimuth_rad[rows.first :]))
        if not told.size:
            return points, np.zeros(points.count)
        share = points.share_log - _log_sum(points.share_log)
        errors = Bearings(points.bias_rad.copy(), points.bias_rad2.copy())
        moment = np.round(late_s[told] / _MOMENT_S)
        half = np.full((points.count, 2), _KERNEL_M)
        for each in np.unique(moment)[::-1]:
            chosen = rows.first + told[moment == each]
            place = points.position_enu_m.copy()
            place[:2] -= each * _MOMENT_S * points.velocity_mps
            mesh = Mesh(place.T, half, np.zeros(points.count))
            errors.add(rows.every.take(chosen), 0, mesh, self._model, share)
        density = _log_sum(share)
        return replace(
            points, share_log=share - density, bias_rad=errors.mean, bias_rad2=errors.variance
        ), density


def _medians(values: FloatArray) -> FloatArray:
    """(r,) of rows (r, N); NumPy's own takes several times as long where N is some hundreds."""
    low, high = (values.shape[1] - 1) // 2, values.shape[1] // 2
    ordered = np.partition(values, (low, high), axis=1)
    result: FloatArray = 0.5 * (ordered[:, low] + ordered[:, high])
    return result


def _log_sum(score: FloatArray) -> FloatArray:
    """Log of the sum of exponentials over the first axis."""
    top = score.max(axis=0)
    result: FloatArray = top + np.log(np.exp(score - top).sum(axis=0))
    return result
