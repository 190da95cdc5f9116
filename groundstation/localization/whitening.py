"""Windows along flights, made independent: each minus what those it resembles foretell of it.

Exists because shadowing is correlated: passing twice over the same ground, with the same vehicle
or another, teaches little, and this model knows. Every observation is conditioned on the few
earlier ones that together foretell most of it (Vecchia, 1988; chosen by ``informative_parents``),
wherever along the flights and of whatever vehicle. Rule: none of the covariances depends on the
candidate, so one whitening serves all; the mixture of a link's two states enters by its first two
moments.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from groundstation.localization.likelihood import (
    expected_excess_db,
    mixture_variance_db2,
    offset_variance_db2,
)
from groundstation.localization.problem import FloatArray, SignalModel


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """n link observations in order of arrival; row i's parents are earlier rows, of any link."""

    position_enu_m: FloatArray
    """(n, 3) where the vehicle was, metres."""
    link: Any
    """(n,) int: number of the vehicle, 0 … V−1."""
    rss_dbm: FloatArray
    """(n,) received power; NaN = none."""
    los_probability: FloatArray
    """(n,) P(line of sight)."""
    white_variance_db2: FloatArray
    """(n,) measurement noise of the power besides shadowing, dB²; larger for what looks an outlier."""
    azimuth_rad: FloatArray
    """(n,) NaN = none."""
    elevation_rad: FloatArray
    """(n,) NaN = none."""
    angle_std_rad: FloatArray
    """(n, 2) standard deviations of azimuth and elevation, the vehicle's constant error apart."""
    angle_probability: FloatArray
    """(n,) P(line of sight) as the angles use it; differs where the power's model is broad anyway."""
    angle_weight: FloatArray
    """(n,) how far whether the angles are genuine is news, 0 to 1: from near by it is not."""
    parents: Any
    """(n, m) int: rows conditioned on; −1 = none."""

    @property
    def count(self) -> int:
        """n."""
        return int(self.rss_dbm.size)

    def take(self, rows: Any) -> Observations:
        """Some of them, related to nobody: for their bearings."""
        parts = {entry.name: getattr(self, entry.name)[rows] for entry in fields(self)}
        parts["parents"] = np.full((parts["link"].size, 0), -1, dtype=np.int64)
        return Observations(**parts)


_POOL = 16
"""Of so many most alike the parents are chosen."""
_LEAST_FORETOLD = 1e-4
"""Share of its variance that a further parent must explain of a row."""
_AT_ONCE = 64
"""Rows related at once: more do not stay in the processor's cache."""
_TIE = 1e-12
"""Of two equally alike the earlier one comes first."""


@dataclass(frozen=True, slots=True, eq=False)
class Whitened:
    """Rows of the whitened regression, the same for every candidate position."""

    rows: Any
    """(r,) int: which observations they come from."""
    mixing: FloatArray
    """(r, 1 + m): factor of the row's own loading and of its parents'."""
    level: FloatArray
    """(r,) whitened y − E[P_t] + E[b]."""
    loading: FloatArray
    """(r, 1 + V): on (P_t, offset of each link), in prior standard deviations."""
    scale: FloatArray
    """(r,) standard deviation before whitening, dB."""

    def take(self, chosen: Any) -> Whitened:
        """The rows that ``chosen`` selects, by mask or by number."""
        return Whitened(*(getattr(self, entry.name)[chosen] for entry in fields(self)))

    def of_links(self, links: int) -> Whitened:
        """The same rows where there are more links by now."""
        more = 1 + links - self.loading.shape[1]
        return self if more <= 0 else replace(self, loading=np.pad(self.loading, ((0, 0), (0, more))))


def _shadowing_covariance(
    observations: Observations, a: Any, b: Any, correlation_m: float, model: SignalModel
) -> FloatArray:
    """Covariance of shadowing between rows a and b (broadcast), dB². LOS and NLOS fields are independent."""
    gap: FloatArray = np.zeros(np.broadcast_shapes(np.shape(a), np.shape(b)))
    other = np.empty_like(gap)
    # Axis by axis and in place: this is the most of what relating costs.
    for axis in observations.position_enu_m.T:
        np.subtract(axis[a], axis[b], out=other)
        other *= other
        gap += other
    np.sqrt(gap, out=gap)
    gap *= -1.0 / correlation_m
    np.exp(gap, out=gap)
    los = observations.los_probability * model.rss_std_db
    nlos = (1.0 - observations.los_probability) * model.nlos_rss_std_db
    np.multiply(los[a], los[b], out=other)
    other += nlos[a] * nlos[b]
    gap *= other
    np.equal(observations.link[a], observations.link[b], out=other)
    other *= 1.0 - model.shared_shadowing
    other += model.shared_shadowing
    gap *= other
    return gap


def _shadowing_variance_db2(observations: Observations, model: SignalModel) -> FloatArray:
    """(n,) of the shadowing that neighbours share: the diagonal of ``_shadowing_covariance``."""
    p = observations.los_probability
    result: FloatArray = p**2 * model.rss_std_db**2 + (1.0 - p) ** 2 * model.nlos_rss_std_db**2
    return result


def _nugget_db2(observations: Observations, model: SignalModel) -> FloatArray:
    """(n,) variance that no other observation shares: noise, and not knowing the link's state."""
    p = observations.los_probability
    total = p * model.rss_std_db**2 + (1.0 - p) * model.nlos_rss_std_db**2
    result: FloatArray = (
        total
        - _shadowing_variance_db2(observations, model)
        + mixture_variance_db2(p, model, model.nlos_bias_max_db)
        + observations.white_variance_db2
    )
    return result


def informative_parents(
    observations: Observations,
    first: int,
    usable: Any,
    count: int,
    correlation_m: float,
    model: SignalModel,
) -> Any:
    """(n − first, count) parents of the rows from ``first`` on, −1 = none: whom to condition each on.

    ``usable`` (n − first, n) bool: who may be a parent of whom. One by one the observation is taken
    that lessens the variance of what is left most (a pivoted Cholesky factorisation of the most
    alike): the nearest ones repeat each other, and of a second lap they miss the first.
    """
    result = np.full((observations.count - first, count), -1, dtype=np.int64)
    if count == 0:
        return result
    for start in range(first, observations.count, _AT_ONCE):
        rows = np.arange(start, min(start + _AT_ONCE, observations.count))
        # Parents are earlier rows: of the later ones nothing is needed.
        some = usable[rows - first, : rows[-1] + 1]
        result[rows - first] = _parents_of(observations, rows, some, count, correlation_m, model)
    return result


def _parents_of(
    observations: Observations, rows: Any, usable: Any, count: int, correlation_m: float, model: SignalModel
) -> Any:
    """(r, count) ``informative_parents`` of ``rows`` (r,) among the first n, as far as ``usable`` (r, n)."""
    result = np.full((rows.size, count), -1, dtype=np.int64)
    columns = np.arange(usable.shape[1])
    pool = min(_POOL, columns.size)
    alike = _shadowing_covariance(observations, rows[:, None], columns, correlation_m, model)
    alike = np.where(usable, alike * (1.0 - _TIE * columns), 0.0)
    near = np.sort(np.argpartition(alike, -pool, axis=1)[:, -pool:], axis=1)
    toward = np.take_along_axis(alike, near, axis=1)
    among = _shadowing_covariance(observations, near[:, :, None], near[:, None, :], correlation_m, model)
    nugget = _nugget_db2(observations, model)
    own = _shadowing_variance_db2(observations, model)
    diagonal = np.arange(pool)
    among[:, diagonal, diagonal] += nugget[near]
    left = among[:, diagonal, diagonal].copy()
    free = toward > 0.0
    least = _LEAST_FORETOLD * (own + nugget)[rows]
    every = np.arange(rows.size)
    factors: list[FloatArray] = []
    for column in range(min(count, pool)):
        gain = np.where(free, toward * toward / np.maximum(left, 1e-9), 0.0)
        chosen = gain.argmax(axis=1)
        found = gain[every, chosen] > least
        if not found.any():
            break
        result[found, column] = near[every, chosen][found]
        free[every, chosen] = False
        root = np.sqrt(np.maximum(left[every, chosen], 1e-9))
        factor = among[every, chosen]
        for before in factors:
            factor = factor - before[every, chosen, None] * before
        factor = factor / root[:, None]
        toward = toward - factor * (toward[every, chosen] / root)[:, None]
        left = left - factor * factor
        factors.append(factor)
    return result


def whiten(
    observations: Observations, first: int, links: int, correlation_m: float, model: SignalModel
) -> Whitened:
    """Whiten the rows from ``first`` on: each minus its expectation given its parents, over its spread."""
    rows = np.arange(first, observations.count)
    rows = rows[np.isfinite(observations.rss_dbm[rows])]
    parents = observations.parents[rows]
    present = parents >= 0
    safe = np.where(present, parents, 0)
    p = observations.los_probability
    shadowing = _shadowing_variance_db2(observations, model)
    nugget = _nugget_db2(observations, model)
    among = _shadowing_covariance(observations, safe[:, :, None], safe[:, None, :], correlation_m, model) * (
        present[:, :, None] & present[:, None, :]
    )
    width = parents.shape[1]
    diagonal = np.arange(width)
    among[:, diagonal, diagonal] += np.where(present, nugget[safe], 1.0)
    toward = _shadowing_covariance(observations, safe, rows[:, None], correlation_m, model) * present
    weights = np.linalg.solve(among, toward[..., None])[..., 0] if rows.size else toward
    variance = shadowing[rows] + nugget[rows] - np.einsum("rm,rm->r", weights, toward)
    scale = np.sqrt(np.maximum(variance, 1e-6))
    mixing = np.concatenate([np.ones((rows.size, 1)), -weights], axis=1) / scale[:, None]
    family = np.concatenate([rows[:, None], safe], axis=1)
    base = (
        np.nan_to_num(observations.rss_dbm)
        - model.receiver_offset_db
        - model.transmit_power_mean_dbm
        + expected_excess_db(p, model.nlos_bias_max_db)
    )
    offset_std = np.sqrt(offset_variance_db2(p, model, model.nlos_bias_max_db))
    loading = np.zeros((rows.size, 1 + links))
    loading[:, 0] = model.transmit_power_std_db * mixing.sum(axis=1)
    own_row = np.repeat(np.arange(rows.size)[:, None], family.shape[1], axis=1)
    np.add.at(loading, (own_row, 1 + observations.link[family]), mixing * offset_std[family])
    level = (mixing * base[family]).sum(axis=1)
    return Whitened(rows, mixing, level, loading, scale)
