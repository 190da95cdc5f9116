"""Peer: weighted nonlinear least squares (SciPy), every window of every vehicle at once.

Exists so that the tracker is measured against what an engineer would write first, tuned
honestly: the same priors, the shadowing's correlation along each flight whitened (first order: what the path
before it does not say), the angles' constant errors estimated as unknowns, several starts. Its belief is
the normal distribution of its own covariance.

Unknowns: x (3), P_t, β_NLOS, b_k of each obstructed vehicle, two constant angle errors of each vehicle in
line of sight; uniform priors enter as normal ones of the same moments, and as bounds.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtr, chdtri

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.tracking.answers import SHARES, Answers
from sim_sitl.studies.tracking.cases import Told
from sim_sitl.studies.tracking.world import Run

STARTS_EN = ((0.0, 0.0), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))
"""Starts, in radii of the area."""
_HALF = 0.5


def fit(run: Run, ticks: Any, told: Told) -> Answers:
    """Answers at ``ticks``, each from all windows up to it."""
    began = time.thread_time()
    answers = Answers.none(len(ticks))
    for row, tick in enumerate(ticks):
        problem = _Problem(run, int(tick), told)
        mean, covariance = problem.solved()
        answers.mean_enu_m[row] = mean
        offset = run.truth_enu_m[tick, :2] - mean[:2]
        plane = covariance[:2, :2]
        answers.level[row] = float(chdtr(2, offset @ np.linalg.solve(plane, offset)))
        size = math.pi * math.sqrt(max(float(np.linalg.det(plane)), 0.0))
        answers.area_m2[row] = [size * float(chdtri(2, 1.0 - share)) for share in SHARES]
    return replace(answers, cpu_s=time.thread_time() - began)


class _Problem:
    """The residuals at one tick, each with a standard deviation of one, and their slopes."""

    def __init__(self, run: Run, tick: int, told: Told) -> None:
        model, self._model = told.model, told.model
        last = tick + 1
        self._places = run.position_enu_m[:last]
        self._rss = run.rss_dbm[:last]
        # A label for each vehicle: the mean of its windows'.
        self._los = run.los_probability[:last].mean(axis=0) >= _HALF
        self._azimuth, self._elevation = run.azimuth_rad[:last], run.elevation_rad[:last]
        self._area = run.area
        step = np.linalg.norm(np.diff(self._places, axis=0), axis=-1)
        self._keep = np.exp(-step / told.settings.correlation_m)
        std = np.where(self._los, model.rss_std_db, model.nlos_rss_std_db)
        self._scale = np.vstack([np.ones((1, std.size)), np.sqrt(1.0 - self._keep**2)]) * std
        self._obstructed = np.flatnonzero(~self._los)
        self._seen = np.flatnonzero(self._los)
        self._angle_std = (model.azimuth_std_rad, model.elevation_std_rad)
        self._constant = max(told.settings.angle_bias_std_rad, 1e-6)
        radius, low, high = run.area.radius_m, run.area.height_min_m, run.area.height_max_m
        center = [0.0, 0.0, _HALF * (low + high), model.transmit_power_mean_dbm]
        spread = [_HALF * radius, _HALF * radius, (high - low) / math.sqrt(12.0), model.transmit_power_std_db]
        least = [-radius, -radius, low, model.transmit_power_min_dbm]
        most = [radius, radius, high, model.transmit_power_max_dbm]
        between = (model.nlos_exponent_min, model.nlos_exponent_max)
        center += [_HALF * sum(between)] + [_HALF * model.nlos_bias_max_db] * self._obstructed.size
        spread += [(between[1] - between[0]) / math.sqrt(12.0)]
        spread += [model.nlos_bias_max_db / math.sqrt(12.0)] * self._obstructed.size
        least += [between[0]] + [0.0] * self._obstructed.size
        most += [between[1]] + [model.nlos_bias_max_db] * self._obstructed.size
        angles = 2 * self._seen.size
        self._center = np.array(center + [0.0] * angles)
        self._spread = np.array(spread + [self._constant] * angles)
        self._least = np.array(least + [-10.0 * self._constant] * angles)
        self._most = np.array(most + [10.0 * self._constant] * angles)

    def solved(self) -> tuple[FloatArray, FloatArray]:
        """Mean (3,) and covariance (3, 3) of the best of all starts."""
        best = None
        for start in STARTS_EN:
            first = self._center.copy()
            first[:2] = np.array(start) * self._area.radius_m
            found = least_squares(
                self.residuals, first, self.slopes, bounds=(self._least, self._most), x_scale=self._spread,
                max_nfev=60,
            )  # fmt: skip
            if best is None or found.cost < best.cost:
                best = found
        assert best is not None
        slopes = self.slopes(best.x)
        covariance = np.linalg.inv(slopes.T @ slopes)
        mean = np.asarray(best.x[:3], dtype=np.float64)
        return mean, np.asarray(covariance[:3, :3], dtype=np.float64)

    def _whitened(self, level: FloatArray) -> FloatArray:
        """(T, K, …) of first order along each flight."""
        extra = (1,) * (level.ndim - 2)
        keep = self._keep.reshape(*self._keep.shape, *extra)
        result = level.copy()
        result[1:] -= keep * level[:-1]
        result /= self._scale.reshape(*self._scale.shape, *extra)
        return result

    def residuals(self, unknown: FloatArray) -> FloatArray:
        """Power, angles, priors."""
        offset = unknown[:3] - self._places
        distance = np.maximum(np.linalg.norm(offset, axis=-1), 1.0)
        exponent = np.where(self._los, self._model.los_exponent, unknown[4])
        bias = np.zeros(self._los.size)
        bias[self._obstructed] = unknown[5 : 5 + self._obstructed.size]
        expected = unknown[3] - 10.0 * exponent * np.log10(distance) - bias
        parts = [self._whitened(self._rss - expected).ravel()]
        for number, vehicle in enumerate(self._seen):
            east, north, up = offset[:, vehicle].T
            at = 5 + self._obstructed.size + 2 * number
            turn = self._azimuth[:, vehicle] - np.arctan2(north, east) - unknown[at]
            turn = np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
            lift = self._elevation[:, vehicle] - np.arctan2(up, np.hypot(east, north)) - unknown[at + 1]
            parts += [turn / self._angle_std[0], lift / self._angle_std[1]]
        parts.append((unknown - self._center) / self._spread)
        return np.concatenate(parts)

    def slopes(self, unknown: FloatArray) -> FloatArray:
        """Of the residuals by the unknowns."""
        offset = unknown[:3] - self._places
        square = np.maximum(np.square(offset).sum(axis=-1), 1.0)
        exponent = np.where(self._los, self._model.los_exponent, unknown[4])
        count, vehicles = square.shape
        power = np.zeros((count, vehicles, unknown.size))
        power[..., :3] = (10.0 / math.log(10.0)) * exponent[:, None] * offset / square[..., None]
        power[..., 3] = -1.0
        power[..., 4] = np.where(self._los, 0.0, 5.0 * np.log10(square))
        power[:, self._obstructed, 5 + np.arange(self._obstructed.size)] = 1.0
        parts = [self._whitened(power).reshape(-1, unknown.size)]
        for number, vehicle in enumerate(self._seen):
            east, north, up = offset[:, vehicle].T
            flat2 = np.maximum(east**2 + north**2, 1.0)
            flat, all2 = np.sqrt(flat2), flat2 + up**2
            turn, lift = np.zeros((count, unknown.size)), np.zeros((count, unknown.size))
            turn[:, 0], turn[:, 1] = north / flat2, -east / flat2
            lift[:, 0], lift[:, 1] = east * up / (flat * all2), north * up / (flat * all2)
            lift[:, 2] = -flat / all2
            at = 5 + self._obstructed.size + 2 * number
            turn[:, at], lift[:, at + 1] = -1.0, -1.0
            parts += [turn / self._angle_std[0], lift / self._angle_std[1]]
        parts.append(np.diag(1.0 / self._spread))
        return np.concatenate(parts)
