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
from scipy.spatial.distance import cdist

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
    place_variance_m2: FloatArray
    """(n, 2) variance of each horizontal axis of the vehicle's told place, and of its height."""

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


def _shadowing_among(
    observations: Observations, groups: Any, correlation_m: float, model: SignalModel
) -> FloatArray:
    """(r, m, m) covariance of shadowing among the rows of each of ``groups`` (r, m), dB².

    LOS and NLOS fields are independent.
    """
    gap = np.zeros((*groups.shape, groups.shape[1]))
    other = np.empty_like(gap)
    # Axis by axis and in place: this is the most of what whitening costs.
    for axis in observations.position_enu_m.T:
        each = axis[groups]
        np.subtract(each[:, :, None], each[:, None, :], out=other)
        other *= other
        gap += other
    np.sqrt(gap, out=gap)
    los, nlos = _of_states(observations.los_probability[groups], model)
    np.multiply(los[:, :, None], los[:, None, :], out=other)
    other += nlos[:, :, None] * nlos[:, None, :]
    link = observations.link[groups]
    same = link[:, :, None] == link[:, None, :]
    return _correlated(gap, other, same, correlation_m, model)


def _shadowing_with_all(
    observations: Observations, rows: Any, columns: int, correlation_m: float, model: SignalModel
) -> FloatArray:
    """(r, columns) the same between ``rows`` (r,) and the first ``columns`` rows."""
    place, link = observations.position_enu_m, observations.link
    gap: FloatArray = cdist(place[rows], place[:columns])
    los, nlos = _of_states(observations.los_probability, model)
    variance = np.multiply.outer(los[rows], los[:columns])
    variance += np.multiply.outer(nlos[rows], nlos[:columns])
    same = link[rows, None] == link[:columns]
    return _correlated(gap, variance, same, correlation_m, model)


def _of_states(p: FloatArray, model: SignalModel) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of a row's shadowing as it enters by its link being LOS, and NLOS; dB."""
    return p * model.rss_std_db, (1.0 - p) * model.nlos_rss_std_db


def _correlated(
    gap_m: FloatArray, variance_db2: FloatArray, same: Any, correlation_m: float, model: SignalModel
) -> FloatArray:
    """Covariances over gaps, which are overwritten; ``same``: of one vehicle."""
    gap_m *= -1.0 / correlation_m
    np.exp(gap_m, out=gap_m)
    gap_m *= variance_db2
    if model.shared_shadowing < 1.0:
        gap_m *= np.where(same, 1.0, model.shared_shadowing)
    return gap_m


def _shadowing_variance_db2(p: FloatArray, model: SignalModel) -> FloatArray:
    """Variance of the shadowing that neighbours share, of links LOS with probability p: the diagonal of
    ``_shadowing_among``."""
    result: FloatArray = p**2 * model.rss_std_db**2 + (1.0 - p) ** 2 * model.nlos_rss_std_db**2
    return result


def _nugget_db2(p: FloatArray, white_variance_db2: FloatArray, model: SignalModel) -> FloatArray:
    """Variance that no other observation shares: noise, and not knowing the link's state."""
    total = p * model.rss_std_db**2 + (1.0 - p) * model.nlos_rss_std_db**2
    result: FloatArray = (
        total
        - _shadowing_variance_db2(p, model)
        + mixture_variance_db2(p, model, model.nlos_bias_max_db)
        + white_variance_db2
    )
    return result


def informative_parents(
    observations: Observations,
    rows: Any,
    usable: Any,
    count: int,
    correlation_m: float,
    model: SignalModel,
) -> Any:
    """(r, count) parents of ``rows`` (r,), which rise; −1 = none: whom to condition each on.

    ``usable`` (r, n) bool: who may be a parent of whom. One by one the observation is taken that
    lessens the variance of what is left most (a pivoted Cholesky factorisation of the most
    alike): the nearest ones repeat each other, and of a second lap they miss the first.
    """
    result = np.full((rows.size, count), -1, dtype=np.int64)
    if count == 0:
        return result
    for start in range(0, rows.size, _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        # Parents are earlier rows: of the later ones nothing is needed.
        before = usable[start : start + _AT_ONCE, : some[-1] + 1]
        result[start : start + _AT_ONCE] = _parents_of(
            observations, some, before, count, correlation_m, model
        )
    return result


def _parents_of(
    observations: Observations, rows: Any, usable: Any, count: int, correlation_m: float, model: SignalModel
) -> Any:
    """(r, count) ``informative_parents`` of ``rows`` (r,) among the first n, as far as ``usable`` (r, n)."""
    result = np.full((rows.size, count), -1, dtype=np.int64)
    columns = usable.shape[1]
    pool = min(_POOL, columns)
    alike = _shadowing_with_all(observations, rows, columns, correlation_m, model)
    alike *= 1.0 - _TIE * np.arange(columns)
    alike *= usable
    near = np.sort(np.argpartition(alike, -pool, axis=1)[:, -pool:], axis=1)
    toward = np.take_along_axis(alike, near, axis=1)
    among = _shadowing_among(observations, near, correlation_m, model)
    p = observations.los_probability
    nugget = _nugget_db2(p, observations.white_variance_db2, model)
    own = _shadowing_variance_db2(p, model)
    left = np.einsum("rpp->rp", among)
    left += nugget[near]
    free = toward > 0.0
    least = _LEAST_FORETOLD * (own + nugget)[rows]
    # Everything given those chosen so far; ``left``, its diagonal, changes with it.
    first, wanted = pool * np.arange(rows.size), min(count, pool)
    for column in range(wanted):
        variance = np.maximum(left, 1e-9)
        gain = toward * toward
        gain /= variance
        gain *= free
        chosen = first + gain.argmax(axis=1)
        found = gain.ravel()[chosen] > least
        if not found.any():
            break
        result[:, column] = np.where(found, near.ravel()[chosen], -1)
        if column == wanted - 1:
            break
        free.ravel()[chosen] = False
        row = among.reshape(-1, pool)[chosen]
        share = row / variance.ravel()[chosen][:, None]
        toward -= share * toward.ravel()[chosen][:, None]
        among -= share[:, :, None] * row[:, None, :]
    return result


def whiten(
    observations: Observations, first: int, links: int, correlation_m: float, model: SignalModel
) -> Whitened:
    """Whiten the rows from ``first`` on: each minus its expectation given its parents, over its spread."""
    rows = np.arange(first, observations.count)
    return whiten_rows(
        observations, rows[np.isfinite(observations.rss_dbm[rows])], links, correlation_m, model
    )


def whiten_rows(
    observations: Observations, rows: Any, links: int, correlation_m: float, model: SignalModel
) -> Whitened:
    """``whiten`` of some ``rows`` (r,), all with power."""
    parents = observations.parents[rows]
    family = np.concatenate([rows[:, None], np.maximum(parents, 0)], axis=1)
    # Each row, its parents; of all that is wanted only of these, never of all that is remembered.
    present = np.concatenate([np.ones((rows.size, 1), dtype=bool), parents >= 0], axis=1)
    p, link = observations.los_probability[family], observations.link[family]
    shadowing = _shadowing_variance_db2(p, model)
    nugget = _nugget_db2(p, observations.white_variance_db2[family], model)
    every = _shadowing_among(observations, family, correlation_m, model)
    every *= present[:, :, None] & present[:, None, :]
    among, toward = every[:, 1:, 1:], every[:, 1:, 0]
    diagonal = np.arange(parents.shape[1])
    among[:, diagonal, diagonal] += np.where(present, nugget, 1.0)[:, 1:]
    weights = np.linalg.solve(among, toward[..., None])[..., 0] if rows.size else toward
    variance = shadowing[:, 0] + nugget[:, 0] - np.einsum("rm,rm->r", weights, toward)
    scale = np.sqrt(np.maximum(variance, 1e-6))
    mixing = np.concatenate([np.ones((rows.size, 1)), -weights], axis=1) / scale[:, None]
    base = (
        observations.rss_dbm[family]
        - model.receiver_offset_db
        - model.transmit_power_mean_dbm
        + expected_excess_db(p, model.nlos_bias_max_db)
    )
    # Row 0 stands in for parents that are not there, with no weight.
    base = np.where(present, base, 0.0)
    offset_std = np.sqrt(offset_variance_db2(p, model, model.nlos_bias_max_db))
    loading = np.zeros((rows.size, 1 + links))
    loading[:, 0] = model.transmit_power_std_db * mixing.sum(axis=1)
    own_row = np.arange(rows.size)[:, None]
    np.add.at(loading, (own_row, 1 + link), mixing * offset_std)
    level = (mixing * base).sum(axis=1)
    return Whitened(rows, mixing, level, loading, scale)
