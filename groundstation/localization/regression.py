"""The likelihood of many windows along flights: correlated rows, whitened into one regression.

Exists because the tracker weighs hundreds of windows that resemble each other, which the sum
over link states (``link_states``) cannot do. Rule: same model, same constants, same formulae as
``likelihood`` states them; with certain link states and unrelated rows both give the same number.

Every observation is conditioned on the few earlier ones that it resembles most (Vecchia, 1988),
wherever along the flights they lie: passing twice over the same ground, with the same vehicle or
another, teaches little, and this model knows. The mixture of a link's two states enters by its
first two moments. None of the covariances depends on x, so one whitening serves all candidates.
What remains is a linear regression at each candidate: power and offsets are integrated in closed
form from running sums, the two exponents (shared by all links of their kind) over a small grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse

from groundstation.localization.likelihood import (
    ANYWHERE,
    ExponentGrid,
    bearing_density,
    expected_excess_db,
    mixture_variance_db2,
    offset_variance_db2,
    path_loss_db,
    stray_share,
)
from groundstation.localization.problem import FloatArray, SignalModel

_FEW_ROWS = 64
"""Up to here, setting up a sparse matrix costs more than it saves."""


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
    """(n, 2) standard deviations of azimuth and elevation."""
    angle_probability: FloatArray
    """(n,) P(line of sight) as the angles use it; differs where the power's model is broad anyway."""
    angle_weight: FloatArray
    """(n,) share of independent evidence in the angles, 0 to 1."""
    parents: Any
    """(n, m) int: rows conditioned on; −1 = none."""

    @property
    def count(self) -> int:
        """n."""
        return int(self.rss_dbm.size)


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


def _shadowing_covariance(
    observations: Observations, a: Any, b: Any, correlation_m: float, model: SignalModel
) -> FloatArray:
    """Covariance of shadowing between rows a and b (broadcast), dB². LOS and NLOS fields are independent."""
    gap = np.linalg.norm(observations.position_enu_m[a] - observations.position_enu_m[b], axis=-1)
    p, q = observations.los_probability[a], observations.los_probability[b]
    both = p * q * model.rss_std_db**2 + (1.0 - p) * (1.0 - q) * model.nlos_rss_std_db**2
    alike = np.where(observations.link[a] == observations.link[b], 1.0, model.shared_shadowing)
    result: FloatArray = both * alike * np.exp(-gap / correlation_m)
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
    total = p * model.rss_std_db**2 + (1.0 - p) * model.nlos_rss_std_db**2
    nugget = (
        total
        - (p**2 * model.rss_std_db**2 + (1.0 - p) ** 2 * model.nlos_rss_std_db**2)
        + mixture_variance_db2(p, model, model.nlos_bias_max_db)
        + observations.white_variance_db2
    )
    among = _shadowing_covariance(observations, safe[:, :, None], safe[:, None, :], correlation_m, model) * (
        present[:, :, None] & present[:, None, :]
    )
    width = parents.shape[1]
    diagonal = np.arange(width)
    among[:, diagonal, diagonal] += np.where(present, nugget[safe], 1.0)
    toward = _shadowing_covariance(observations, safe, rows[:, None], correlation_m, model) * present
    weights = np.linalg.solve(among, toward[..., None])[..., 0] if rows.size else toward
    own = p[rows] ** 2 * model.rss_std_db**2 + (1.0 - p[rows]) ** 2 * model.nlos_rss_std_db**2
    variance = own + nugget[rows] - np.einsum("rm,rm->r", weights, toward)
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


@dataclass(slots=True, eq=False)
class Evidence:
    """Running sums of the whitened regression at C candidates; ``add`` rows, read ``log_likelihood``."""

    level_level: float
    level_loading: FloatArray
    """(1 + V,)"""
    loading_loading: FloatArray
    """(1 + V, 1 + V), prior included."""
    level_path: FloatArray
    """(2, C): level × path loss of LOS, NLOS."""
    path_path: FloatArray
    """(3, C): LOS·LOS, LOS·NLOS, NLOS·NLOS."""
    loading_path: FloatArray
    """(2, 1 + V, C)."""
    angle_log: FloatArray
    """(N, C) log likelihood of the angles for each node of π, the share of LOS links."""
    count: int = 0
    """Rows taken in."""

    @classmethod
    def empty(cls, candidates: int, links: int, shares: int = 1) -> Evidence:
        """No evidence at ``candidates`` places from ``links`` links, for ``shares`` nodes of π."""
        return cls(
            0.0,
            np.zeros(1 + links),
            np.eye(1 + links),
            np.zeros((2, candidates)),
            np.zeros((3, candidates)),
            np.zeros((2, 1 + links, candidates)),
            np.zeros((shares, candidates)),
        )

    @classmethod
    def gathered(cls, parts: list[Evidence], place: Any) -> Evidence:
        """The same rows' evidence at candidates of several parts: ``place`` (C,) counts through them."""

        def joined(arrays: list[FloatArray]) -> FloatArray:
            result: FloatArray = np.concatenate(arrays, axis=-1)[..., place]
            return result

        first = parts[0]
        return cls(
            first.level_level,
            first.level_loading,
            first.loading_loading,
            joined([part.level_path for part in parts]),
            joined([part.path_path for part in parts]),
            joined([part.loading_path for part in parts]),
            joined([part.angle_log for part in parts]),
            first.count,
        )

    def grow(self, links: int) -> None:
        """Make room for links not heard before."""
        more = 1 + links - self.level_loading.size
        if more <= 0:
            return
        self.level_loading = np.concatenate([self.level_loading, np.zeros(more)])
        size = self.loading_loading.shape[0]
        wider = np.eye(size + more)
        wider[:size, :size] = self.loading_loading
        self.loading_loading = wider
        pad = np.zeros((2, more, self.angle_log.shape[1]))
        self.loading_path = np.concatenate([self.loading_path, pad], axis=1)

    def add(self, observations: Observations, rows: Whitened, candidates: FloatArray) -> None:
        """Take in whitened rows; ``candidates`` (C, 3) metres ENU."""
        if not rows.rows.size:
            return
        los, nlos = self.path_rows(observations, rows, candidates)
        self.count += int(rows.rows.size)
        self.level_level += float(rows.level @ rows.level)
        self.level_loading += rows.loading.T @ rows.level
        self.loading_loading += rows.loading.T @ rows.loading
        self.level_path[0] += rows.level @ los
        self.level_path[1] += rows.level @ nlos
        self.path_path[0] += np.einsum("rc,rc->c", los, los)
        self.path_path[1] += np.einsum("rc,rc->c", los, nlos)
        self.path_path[2] += np.einsum("rc,rc->c", nlos, nlos)
        used = np.flatnonzero(rows.loading.any(axis=0))
        part = np.ascontiguousarray(rows.loading[:, used].T)
        self.loading_path[0][used] += part @ los
        self.loading_path[1][used] += part @ nlos

    @staticmethod
    def path_rows(
        observations: Observations, rows: Whitened, candidates: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Whitened 10 log₁₀ d of each row at each candidate, for LOS and NLOS: two (r, C)."""
        parents = observations.parents[rows.rows]
        family = np.concatenate([rows.rows[:, None], np.where(parents >= 0, parents, 0)], axis=1)
        needed, where = np.unique(family, return_inverse=True)
        where = where.reshape(family.shape)
        path = path_loss_db(observations.position_enu_m[needed], candidates)
        p = observations.los_probability[needed]
        index = np.repeat(np.arange(rows.rows.size), family.shape[1])
        shape = (rows.rows.size, needed.size)

        def mix(share: FloatArray) -> FloatArray:
            if not share.any():
                return np.zeros((shape[0], path.shape[1]))
            weights = rows.mixing * share[where]
            if rows.rows.size <= _FEW_ROWS:
                mixed = weights[:, :1] * path[where[:, 0]]
                for member in range(1, weights.shape[1]):
                    mixed += weights[:, member, None] * path[where[:, member]]
                return mixed
            # Few entries a row: a sparse product costs a hundredth of the dense one.
            sparse = scipy.sparse.csr_array((weights.ravel(), (index, where.ravel())), shape=shape)
            return np.asarray(sparse @ path, dtype=np.float64)

        return mix(p), mix(1.0 - p)

    def _reduced(self, cells: Any = slice(None)) -> tuple[float, FloatArray, FloatArray]:
        """The quadratic form's terms at ``cells`` with power and offsets integrated out."""
        factor = np.linalg.cholesky(self.loading_loading)
        inverse = np.linalg.inv(factor)
        level = inverse @ self.level_loading
        los = inverse @ self.loading_path[0][:, cells]
        nlos = inverse @ self.loading_path[1][:, cells]
        cross = self.level_path[:, cells] - np.stack([level @ los, level @ nlos])
        square = self.path_path[:, cells] - np.stack(
            [
                np.einsum("vc,vc->c", los, los),
                np.einsum("vc,vc->c", los, nlos),
                np.einsum("vc,vc->c", nlos, nlos),
            ]
        )
        return self.level_level - float(level @ level), cross, square

    def log_likelihood(self, exponents: ExponentGrid, noise_degrees: float | None = None) -> FloatArray:
        """(C,) log likelihood of each candidate, up to a constant.

        ``noise_degrees`` None: the model's noise level is right. Else it is itself unknown,
        inverse-gamma round the model's with so many degrees of freedom, and integrated out
        (a multivariate Student-t): residuals larger than expected widen the belief.
        """
        constant, cross, square = self._reduced()
        los, nlos = exponents.los[:, None], exponents.nlos[:, None]
        form = constant + 2.0 * (los * cross[0] + nlos * cross[1])
        form += los**2 * square[0] + 2.0 * los * nlos * square[1] + nlos**2 * square[2]
        if noise_degrees is None:
            score = exponents.log_prior[:, None] - 0.5 * form
        else:
            weight = 0.5 * (noise_degrees + self.count)
            score = exponents.log_prior[:, None] - weight * np.log1p(np.maximum(form, 0.0) / noise_degrees)
        top = score.max(axis=0)
        power: FloatArray = top + np.log(np.exp(score - top).sum(axis=0))
        # The nodes of π are equally likely.
        best = self.angle_log.max(axis=0)
        angles: FloatArray = best + np.log(np.exp(self.angle_log - best).mean(axis=0))
        return power + angles

    def exponents_at(self, candidate: int, exponents: ExponentGrid) -> tuple[FloatArray, float, float]:
        """Posterior (Q,) over the grid's nodes at one candidate, and its mean β_LOS and β_NLOS."""
        constant, cross, square = self._reduced(slice(candidate, candidate + 1))
        c, s = cross[:, 0], square[:, 0]
        form = constant + 2.0 * (exponents.los * c[0] + exponents.nlos * c[1])
        form += exponents.los**2 * s[0] + 2.0 * exponents.los * exponents.nlos * s[1]
        form += exponents.nlos**2 * s[2]
        score = exponents.log_prior - 0.5 * form
        mass = np.exp(score - score.max())
        mass /= mass.sum()
        return mass, float(mass @ exponents.los), float(mass @ exponents.nlos)

    def nuisances_at(self, candidate: int, los_exponent: float, nlos_exponent: float) -> FloatArray:
        """(1 + V,) posterior mean of power and offsets, in prior standard deviations."""
        right = (
            self.level_loading
            + los_exponent * self.loading_path[0, :, candidate]
            + nlos_exponent * self.loading_path[1, :, candidate]
        )
        return np.asarray(np.linalg.solve(self.loading_loading, right), dtype=np.float64)


def angle_log_likelihood(
    observations: Observations,
    first: int,
    candidates: FloatArray,
    half_m: FloatArray,
    model: SignalModel,
) -> FloatArray:
    """(N, C) summed log likelihood of the angles of rows from ``first`` on, for each ``model.los_shares``.

    ``half_m`` (C, 2): half the width and height of the cell that each candidate stands for;
    the angle's spread over the cell is added to its variance, so that a coarse cell is not
    thrown away because its centre lies beside a narrow ray.
    """
    shares = np.array(model.los_shares)[:, None]
    total = np.zeros((shares.size, candidates.shape[0]))
    for row in range(first, observations.count):
        p = observations.angle_probability[row]
        azimuth, elevation = observations.azimuth_rad[row], observations.elevation_rad[row]
        if not (math.isfinite(azimuth) and math.isfinite(elevation)) or p <= 0.0:
            continue
        weight = observations.angle_weight[row]
        right = 2.0 * p * shares
        trusted = right * (1.0 - stray_share(model))
        stray = (right - trusted + 2.0 * (1.0 - p) * (1.0 - shares)) * ANYWHERE
        anywhere = np.log(stray)
        total += weight * anywhere
        std_az, std_el = observations.angle_std_rad[row]
        offset = candidates - observations.position_enu_m[row]
        spread = half_m[:, 0] ** 2 / 3.0
        near = _near_the_ray(offset, spread, float(azimuth), float(std_az))
        offset, spread, high = offset[near], spread[near], half_m[near, 1]
        density = bearing_density(
            offset.T,
            spread,
            high**2 / 3.0,
            (float(azimuth), float(elevation)),
            (float(std_az), float(std_el)),
        )
        total[:, near] += weight * (np.log(trusted * density + stray) - anywhere)
    return total


def _near_the_ray(offset: FloatArray, spread_m2: FloatArray, azimuth_rad: float, std_rad: float) -> Any:
    """Indices of the cells where a bearing's density is not nothing (e⁻⁴⁰): most are far off a narrow ray."""
    east, north = math.cos(azimuth_rad), math.sin(azimuth_rad)
    along = offset[:, 0] * east + offset[:, 1] * north
    across = offset[:, 1] * east - offset[:, 0] * north
    horizontal2 = np.maximum(along**2 + across**2, 0.01)
    variance_m2 = std_rad**2 * horizontal2 + spread_m2
    # Behind the vehicle the turn is over 90°: nothing, unless the spread is wide.
    ahead = (along > 0.0) | (variance_m2 > 0.03 * horizontal2)
    return np.flatnonzero((across**2 < 80.0 * variance_m2) & ahead)
