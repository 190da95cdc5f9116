"""Peer: a bootstrap particle filter, with filterpy's resampling.

Exists so that the tracker is measured against what the field uses for such problems (Gordon,
Salmond & Smith, 1993), tuned honestly. A particle holds all unknowns: x (3), P_t, β_NLOS, each vehicle's
b_k and the constant errors of its angles. All are constant, so after resampling they are moved as Liu and
West (2001) do: drawn toward the mean and jittered by as much as keeps their spread. Rules: it is told
what the tracker is told; a window's power is weighed given the vehicle's last one (the shadowing's
correlation along the flight, first order), for a filter that takes windows as independent is far too sure.

Tuning (10 runs, of those that seed 1 scores): more than 4,000 particles bring nothing on obstructed links,
and of a = 0.995, 0.98, 0.95, 0.9 the last scores best there; with a line of sight 0.95 beat 0.98 and
0.9 was not tried.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from groundstation.localization.problem import FloatArray
from sim_sitl.studies.tracking.answers import SHARES, Answers, points_region
from sim_sitl.studies.tracking.cases import Told
from sim_sitl.studies.tracking.world import Run

PARTICLES = 4000
RESAMPLE_BELOW = 0.5
"""Effective share of the particles below which they are resampled."""
SHRINKAGE = 0.9
"""Liu and West's a: what is left of a particle's distance from the mean."""
_ANYWHERE = 1.0 / (2.0 * math.pi**2)
_POWER, _EXPONENT, _BIAS = 3, 4, 5


def track_particles(run: Run, ticks: Any, told: Told, seed: int, count: int = PARTICLES) -> Answers:
    """Answers at ``ticks``."""
    from filterpy.monte_carlo import systematic_resample

    began = time.thread_time()
    rng = np.random.default_rng(seed)
    cloud = _Cloud(run, told, rng, count)
    answers = Answers.none(len(ticks))
    row = 0
    for tick in range(int(max(ticks)) + 1):
        cloud.weigh(tick)
        if tick == ticks[row]:
            answers.mean_enu_m[row] = cloud.weight @ cloud.state[:, :3]
            answers.level[row], answers.area_m2[row] = points_region(
                cloud.state[:, :2], cloud.weight, run.truth_enu_m[tick, :2]
            )
            row += 1
        if 1.0 / np.square(cloud.weight).sum() < RESAMPLE_BELOW * count:
            # filterpy draws from NumPy's global generator: seeded, and put back.
            before = np.random.get_state()
            np.random.seed(int(rng.integers(2**32)))
            chosen = systematic_resample(cloud.weight)
            np.random.set_state(before)
            cloud.resample(np.asarray(chosen))
    assert answers.area_m2.shape[1] == len(SHARES)
    return replace(answers, cpu_s=time.thread_time() - began)


class _Cloud:
    """Particles (N, S) and their weights (N,)."""

    def __init__(self, run: Run, told: Told, rng: np.random.Generator, count: int) -> None:
        self._run, self._told, self._rng = run, told, rng
        model, area, vehicles = told.model, run.area, run.rss_dbm.shape[1]
        turn = 2.0 * math.pi * rng.random(count)
        reach = area.radius_m * np.sqrt(rng.random(count))
        self._angles = _BIAS + vehicles
        self.state = np.empty((count, self._angles + 2 * vehicles))
        self.state[:, 0], self.state[:, 1] = reach * np.cos(turn), reach * np.sin(turn)
        self._least = np.array(
            [area.height_min_m, model.transmit_power_min_dbm, model.nlos_exponent_min] + [0.0] * vehicles
        )
        self._most = np.array(
            [area.height_max_m, model.transmit_power_max_dbm, model.nlos_exponent_max]
            + [model.nlos_bias_max_db] * vehicles
        )
        uniform = rng.random((count, self._least.size))
        self.state[:, 2 : self._angles] = self._least + uniform * (self._most - self._least)
        errors = rng.standard_normal((count, 2 * vehicles))
        self.state[:, self._angles :] = told.settings.angle_bias_std_rad * errors
        self.weight: FloatArray = np.full(count, 1.0 / count)

    def weigh(self, tick: int) -> None:
        """Bayes' rule for the windows of one tick."""
        run, model, settings = self._run, self._told.model, self._told.settings
        offset = self.state[:, None, :3] - run.position_enu_m[tick]
        p = run.los_probability[tick]
        keep, before = np.zeros(p.size), np.zeros((2, *offset.shape[:2]))
        if tick > 0:
            # Of the particles as they are now: they may have been moved since.
            before = self._residuals(tick - 1)
            step = np.linalg.norm(run.position_enu_m[tick] - run.position_enu_m[tick - 1], axis=-1)
            keep = np.exp(-step / settings.correlation_m)
        now = self._residuals(tick)
        density = np.zeros(offset.shape[:2])
        states = ((p, model.rss_std_db, True), (1.0 - p, model.nlos_rss_std_db, False))
        for place, (share, std, seen) in enumerate(states):
            if not share.any():
                continue
            scale = std * np.sqrt(1.0 - keep**2)
            innovation = (now[place] - keep * before[place]) / scale
            part = share * np.exp(-0.5 * np.square(innovation)) / scale
            density += part * (self._angle_density(tick, offset) if seen else _ANYWHERE)
        score = np.log(np.maximum(density, 1e-300)).sum(axis=1) + np.log(np.maximum(self.weight, 1e-300))
        weight = np.exp(score - score.max())
        self.weight = weight / weight.sum()

    def _residuals(self, tick: int) -> FloatArray:
        """(2, N, K) shadowing that the particles ask for, on a line of sight and obstructed, dB."""
        run, state = self._run, self.state
        offset = state[:, None, :3] - run.position_enu_m[tick]
        loss = 5.0 * np.log10(np.maximum(np.einsum("nkx,nkx->nk", offset, offset), 1.0))
        # 10 β log₁₀ d is β times 5 log₁₀ d².
        power = run.rss_dbm[tick] - state[:, None, _POWER]
        nlos = power + state[:, None, _EXPONENT] * loss + state[:, _BIAS : self._angles]
        return np.stack([power + self._told.model.los_exponent * loss, nlos])

    def _angle_density(self, tick: int, offset: FloatArray) -> FloatArray:
        """(N, K) of the bearing, if the link is in line of sight."""
        run, model, vehicles = self._run, self._told.model, offset.shape[1]
        east, north, up = np.moveaxis(offset, -1, 0)
        turn_error = self.state[:, self._angles : self._angles + vehicles]
        lift_error = self.state[:, self._angles + vehicles :]
        turn = run.azimuth_rad[tick] - np.arctan2(north, east) - turn_error
        turn = np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
        lift = run.elevation_rad[tick] - np.arctan2(up, np.hypot(east, north)) - lift_error
        across, along = model.azimuth_std_rad, model.elevation_std_rad
        exponent = -0.5 * (np.square(turn / across) + np.square(lift / along))
        stray = self._told.settings.angle_outlier_probability
        density: FloatArray = (1.0 - stray) * np.exp(exponent) / (2.0 * math.pi * across * along)
        return density + stray * _ANYWHERE

    def resample(self, chosen: Any) -> None:
        """Liu and West's move of the particles ``chosen`` (N,)."""
        mean = self.weight @ self.state
        offset = self.state - mean
        covariance = (offset.T * self.weight) @ offset
        covariance[np.diag_indices_from(covariance)] += 1e-12
        factor = math.sqrt(1.0 - SHRINKAGE**2) * np.linalg.cholesky(covariance)
        before = self.state[chosen]
        moved = mean + SHRINKAGE * (before - mean)
        moved += self._rng.standard_normal(moved.shape) @ factor.T
        # What leaves its prior's range comes back by as much.
        inner = moved[:, 2 : self._angles]
        inner = np.where(inner < self._least, 2.0 * self._least - inner, inner)
        inner = np.where(inner > self._most, 2.0 * self._most - inner, inner)
        moved[:, 2 : self._angles] = np.clip(inner, self._least, self._most)
        reach = np.hypot(moved[:, 0], moved[:, 1])
        outside = reach > self._run.area.radius_m
        moved[outside, :2] *= (self._run.area.radius_m / reach[outside])[:, None]
        self.state = moved
        self.weight = np.full(chosen.size, 1.0 / chosen.size)
