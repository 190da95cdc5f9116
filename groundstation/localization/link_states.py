"""The likelihood of one snapshot: every combination of the doubtful links' states, summed.

Exists because a link that may be LOS or NLOS is two hypotheses, under which its power and its
bearing mean different things together; one Gaussian between them (``regression``) says less and,
with a bearing, something else. Rules: the model is ``likelihood``'s; many problems side by side,
each box named with its problem; links beyond the most doubtful few enter by their moments, as
the tracker's do, so that the cost is bounded for any number of links.

For certain states s the sum is the tracker's regression with unrelated rows; the snapshot's
likelihood is Σ_s P(s) p(y, bearings | x, s).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundstation.localization.likelihood import (
    ANYWHERE,
    ExponentGrid,
    bearing_density,
    expected_excess_db,
    mixture_variance_db2,
    offset_variance_db2,
    path_loss_of_square,
    stray_share,
)
from groundstation.localization.problem import BoolArray, FloatArray, Links, SignalModel

MAXIMUM_DOUBTFUL = 6
"""Links whose states are summed over; 2⁶ combinations."""
MAXIMUM_SUSPECTS = 6
"""Links whose power may be an outlier, one at a time."""
_LIKELY = 0.1
"""States so much less probable than the most probable are not thought of beside an outlier."""
_DOUBT = 1e-3
_BEARING_CLAIM = 100.0
"""A bearing that agrees raises the odds of LOS by about so much: a link with one is in doubt sooner."""
_WIDE = 4.0
"""A box is wider than a ray from about 1.7 σ on."""
_BLOCK = 30_000
"""Numbers worked on at once: what stays in the processor's cache."""


def doubtful_links(links: Links) -> Any:
    """(N, K) bool: which links of each problem are neither surely LOS nor surely NLOS, the most doubtful."""
    p = np.nan_to_num(links.los_probability, nan=0.0)
    doubt = np.minimum(p * np.where(links.has_angle(), _BEARING_CLAIM, 1.0), 1.0 - p)
    chosen = doubt > _DOUBT
    if (chosen.sum(axis=1) > MAXIMUM_DOUBTFUL).any():
        rank = np.argsort(np.argsort(-doubt, axis=1, kind="stable"), axis=1, kind="stable")
        chosen &= rank < MAXIMUM_DOUBTFUL
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class LinkStates:
    """N problems of K links whose doubtful links are the same columns.

    A "column" below is a link in one state: certain links have one (at their own p), doubtful
    ones two; each may have a twin, in which the link's power is an outlier. A combination takes
    one column of each link, at most one of them a twin.
    """

    place: FloatArray
    """(3, K, N) metres."""
    bearing: FloatArray
    """(2, B, N) azimuth and elevation, radians, of the links that have any; NaN = none."""
    model: SignalModel
    exponents: ExponentGrid
    link: Any
    """(A,) which link a column is of."""
    bearing_of: Any
    """(A,) which row of ``bearing`` speaks in a column; −1 = none."""
    probability: FloatArray
    """(A, N) P(LOS) in this column: 1 or 0 for doubtful links."""
    level: FloatArray
    """(A, N) y − E[P_t] + E[b], over the standard deviation."""
    precision: FloatArray
    """(A, N) 1 / standard deviation, 1/dB."""
    member: FloatArray
    """(S, A) 1 where a combination takes the column."""
    log_prior: FloatArray
    """(S, N) log of prior and normalisation of each combination."""
    shrink: FloatArray
    """(S, N) dB²: τ²/(1 + τ² Σ 1/v), the variance of P_t given all."""
    strange: Any
    """(S,) bool: combinations in which one power is an outlier."""

    @classmethod
    def of(
        cls, links: Links, model: SignalModel, bias_max_db: FloatArray, doubtful: Any, exponents: ExponentGrid
    ) -> LinkStates:
        """``links`` (N, K), ``bias_max_db`` (N,), ``doubtful`` (K,) bool."""
        known = np.nan_to_num(links.los_probability, nan=0.0).T
        certain, doubted = np.flatnonzero(~doubtful), np.flatnonzero(doubtful)
        count, rows = doubted.size, known.shape[1]
        link = np.concatenate([certain, doubted, doubted])
        p = np.concatenate([known[certain], np.ones((count, rows)), np.zeros((count, rows))])
        bit = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
        member = np.concatenate([np.ones((2**count, certain.size)), bit, 1 - bit], axis=1)
        variance = p * model.rss_std_db**2 + (1.0 - p) * model.nlos_rss_std_db**2
        variance += offset_variance_db2(p, model, bias_max_db) + mixture_variance_db2(p, model, bias_max_db)
        log_prior = _log_prior(bit, known[doubted], known[certain], model)
        suspects = _suspects(links, model)
        if suspects.size:
            member, log_prior = _with_outliers(member, log_prior, link, suspects, links.count, model)
            link, p = np.concatenate([link, link]), np.concatenate([p, p])
            variance = np.concatenate([variance, variance + model.rss_outlier_std_db**2])
        precision = 1.0 / np.sqrt(variance)
        level = links.rss_dbm.T[link] - model.receiver_offset_db - model.transmit_power_mean_dbm
        level = (level + expected_excess_db(p, bias_max_db)) * precision
        information = 1.0 + model.transmit_power_std_db**2 * (member @ precision**2)
        heard = links.has_angle().T
        speaking = np.flatnonzero((heard & (known > 0.0)).any(axis=1))
        row_of = np.full(links.count, -1)
        row_of[speaking] = np.arange(speaking.size)
        bearing_of = np.concatenate([row_of[certain], row_of[doubted], np.full(count, -1)])
        bearing_of = np.tile(bearing_of, link.size // bearing_of.size)
        log_prior = log_prior + member @ np.log(precision) - 0.5 * np.log(information)
        azimuth = np.where(heard, links.azimuth_rad.T, np.nan)[speaking]
        elevation = np.where(heard, links.elevation_rad.T, np.nan)[speaking]
        return cls(
            np.ascontiguousarray(links.position_enu_m.T),
            np.stack([azimuth, elevation]),
            model,
            exponents,
            link,
            bearing_of,
            p,
            level,
            precision,
            member,
            log_prior,
            model.transmit_power_std_db**2 / information,
            np.arange(member.shape[0]) >= 2**count,
        )

    def problem(self, index: int) -> LinkStates:
        """One of the N problems."""
        if self.place.shape[2] == 1:
            return self
        one = slice(index, index + 1)
        return LinkStates(
            self.place[..., one].copy(), self.bearing[..., one].copy(), self.model, self.exponents,
            self.link, self.bearing_of, self.probability[:, one].copy(), self.level[:, one].copy(),
            self.precision[:, one].copy(), self.member, self.log_prior[:, one].copy(),
            self.shrink[:, one].copy(), self.strange,
        )  # fmt: skip

    @property
    def combinations(self) -> int:
        """S."""
        return int(self.member.shape[0])

    def only(self, keep: BoolArray) -> LinkStates:
        """With the combinations that ``keep`` (S, N) selects for each problem, and the columns they take."""
        if np.all(keep):
            return self
        some = keep.any(axis=1)
        member = self.member[some]
        used = np.flatnonzero(member.any(axis=0))
        return replace(
            self,
            link=self.link[used],
            bearing_of=self.bearing_of[used],
            probability=self.probability[used],
            level=self.level[used],
            precision=self.precision[used],
            member=member[:, used],
            log_prior=np.where(keep, self.log_prior, -np.inf)[some],
            shrink=self.shrink[some],
            strange=self.strange[some],
        )

    def log_likelihood(
        self, problem: Any, center_enu_m: FloatArray, half_m: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """(C,) log likelihood of boxes, up to a constant of each problem; (C,) whether the box is
        wider than a ray through it.

        ``problem`` (C,): whose box; ``center_enu_m`` (C, 3); ``half_m`` (C, 2) half the width and
        half the height: nought for a point.
        """
        return self._summed(problem, center_enu_m, half_m, (0, 1), (problem.size,))

    def by_combination(
        self, problem: Any, center_enu_m: FloatArray, half_m: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """(S, C) the same for each combination of link states: their sum is the likelihood."""
        return self._summed(problem, center_enu_m, half_m, (0,), (self.member.shape[0], problem.size))

    def _summed(
        self, problem: Any, center: FloatArray, half: FloatArray, over: tuple[int, ...], shape: Any
    ) -> tuple[FloatArray, BoolArray]:
        result, coarse = np.empty(shape), np.empty(problem.size, dtype=bool)
        step = max(_BLOCK // (self.exponents.nlos.size * self.member.shape[0]), 64)
        for first in range(0, problem.size, step):
            block = slice(first, first + step)
            score, coarse[block] = self.scores(problem[block], center[block], half[block])
            top = score.max(axis=over)
            score -= top
            np.exp(score, out=score)
            result[..., block] = np.log(score.sum(axis=over)) + top
        return result, coarse

    def scores(
        self, problem: Any, center_enu_m: FloatArray, half_m: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """(Q, S, C) log likelihood and prior for each node of the exponents and each combination;
        (C,) whether a bearing's ray passes that is narrower than the box."""
        mine = _pick(problem, self.place.shape[2])
        offset = center_enu_m.T[:, None, :] - mine(self.place)
        square = np.einsum("ikc,ikc->kc", offset, offset)
        coarse = np.zeros(square.shape[1], dtype=bool)
        claims: FloatArray | None = None
        speaking = (self.bearing_of >= 0).nonzero()[0]
        if speaking.size:
            # A twin says of the bearing what its original says.
            first: dict[int, int] = {}
            for column, bearing in zip(speaking.tolist(), self.bearing_of[speaking].tolist(), strict=True):
                first.setdefault(bearing, column)
            number = {bearing: row for row, bearing in enumerate(first)}
            said, coarse = self._bearing_claims(list(first.values()), mine, offset, square, half_m)
            claims = said[[number[bearing] for bearing in self.bearing_of[speaking].tolist()]]
        path = path_loss_of_square(square)[self.link]
        precision, p = mine(self.precision), mine(self.probability)
        path *= precision
        obstructed = path * (1.0 - p)
        path -= obstructed
        columns, boxes = path.shape
        parts = np.empty((columns, 5, boxes))
        np.multiply(obstructed, obstructed, out=parts[:, 2])
        np.multiply(obstructed, precision, out=parts[:, 4])
        nlos = self.exponents.nlos_nodes[:, None, None]
        scores = np.empty((self.exponents.los_nodes.size, nlos.size, self.combinations, boxes))
        for los, score, log_prior in zip(
            self.exponents.los_nodes, scores, self.exponents.log_prior[:: nlos.size], strict=True
        ):
            flat = mine(self.level) + los * path
            np.multiply(flat, flat, out=parts[:, 0])
            np.multiply(flat, obstructed, out=parts[:, 1])
            np.multiply(flat, precision, out=parts[:, 3])
            if claims is not None:
                parts[speaking, 0] -= claims
            self._over_nodes(parts, mine, nlos, score)
            np.add(score, log_prior, out=score)
        return scores.reshape(-1, *scores.shape[2:]), coarse

    def _over_nodes(self, parts: FloatArray, mine: Any, nlos: FloatArray, score: FloatArray) -> None:
        """Into ``score`` (Q, S, C): the quadratic in β_NLOS of each combination with P_t integrated out.

        ``parts`` (A, 5, C): of residual r₀ + β r₁ the sums r₀², r₀r₁, r₁², r₀w, r₁w, w = 1/σ.
        """
        columns, _, boxes = parts.shape
        summed = (self.member @ parts.reshape(columns, -1)).reshape(-1, 5, boxes)
        power, slope = summed[:, 3], summed[:, 4]
        shrink = mine(self.shrink)
        shrunk = shrink * power
        np.multiply(0.5 * (shrink * slope * slope - summed[:, 2]), nlos, out=score)
        score += shrunk * slope - summed[:, 1]
        score *= nlos
        score += mine(self.log_prior) - 0.5 * (summed[:, 0] - shrunk * power)

    def nuisances(self, problem: Any, place_enu_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Posterior means at places (C, 3) of problems (C,): P_t (C,) dBm, β (C, K), P(LOS) (C, K)."""
        mine = _pick(problem, self.place.shape[2])
        weight, _ = self.scores(problem, place_enu_m, np.zeros((problem.size, 2)))
        weight = np.exp(weight - weight.max(axis=(0, 1)))
        weight /= weight.sum(axis=(0, 1))
        p, precision = mine(self.probability), mine(self.precision)
        offset = place_enu_m.T[:, None, :] - mine(self.place)
        path = path_loss_of_square(np.einsum("ikc,ikc->kc", offset, offset))[self.link]
        mean = p * self.exponents.los[:, None, None] + (1.0 - p) * self.exponents.nlos[:, None, None]
        residual = (mine(self.level) + mean * path * precision) * precision
        power = (weight * mine(self.shrink) * (self.member @ residual)).sum(axis=(0, 1))
        column = self.member.T @ weight
        of_link = (self.link == np.arange(self.place.shape[1])[:, None]).astype(np.float64)
        exponent = of_link @ (column * mean).sum(axis=0)
        los = of_link @ (column.sum(axis=0) * p)
        return self.model.transmit_power_mean_dbm + power, exponent.T, los.T

    def _bearing_claims(
        self, speaking: Any, mine: Any, offset: FloatArray, square: FloatArray, half_m: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """(speaking columns, C) twice the log of what a bearing says over one that points anywhere;
        (C,) whether a box that a bearing speaks for is wider than its ray."""
        model = self.model
        azimuth, elevation = mine(self.bearing[:, self.bearing_of[speaking]])
        across, upright = half_m.T**2 / 3.0
        links = self.link[speaking]
        ratio = bearing_density(
            offset[:, links],
            across,
            upright,
            (azimuth, elevation),
            (model.azimuth_std_rad, model.elevation_std_rad),
            model.vehicle_variance_m2,
        )
        stray = stray_share(model)
        ratio *= (1.0 - stray) / ANYWHERE
        ratio += stray - 1.0
        ratio *= mine(self.probability[speaking])
        np.log1p(ratio, out=ratio)
        ratio *= 2.0
        if np.isnan(azimuth).any():
            ratio = np.where(np.isfinite(azimuth), ratio, 0.0)
        width2 = (across + 0.5 * upright) * (_WIDE / min(model.azimuth_std_rad, model.elevation_std_rad) ** 2)
        return ratio, np.asarray(((ratio > 0.0) & (width2 > square[links])).any(axis=0))


def _suspects(links: Links, model: SignalModel) -> Any:
    """(J,) links whose power may be an outlier: all; of many those that stand out most somewhere."""
    if model.rss_outlier_probability <= 0.0:
        return np.zeros(0, dtype=np.int64)
    if links.count <= MAXIMUM_SUSPECTS:
        return np.arange(links.count)
    middle = np.median(links.rss_dbm, axis=1, keepdims=True)
    worst = np.abs(links.rss_dbm - middle).max(axis=0)
    return np.sort(np.argsort(-worst, kind="stable")[:MAXIMUM_SUSPECTS])


def _with_outliers(
    member: FloatArray, log_prior: FloatArray, link: Any, suspects: Any, links: int, model: SignalModel
) -> tuple[FloatArray, FloatArray]:
    """Combinations without an outlier, then with each suspect's power for one: members, log priors.

    Unlikely states and an outlier at once are left out.
    """
    share = model.rss_outlier_probability
    likely = (log_prior > log_prior.max(axis=0) + math.log(_LIKELY)).any(axis=1)
    usual, usual_prior = member[likely], log_prior[likely]
    members = [np.concatenate([member, np.zeros_like(member)], axis=1)]
    priors = [log_prior + links * math.log1p(-share)]
    for suspect in suspects:
        mine = link == suspect
        members.append(np.concatenate([usual * ~mine, usual * mine], axis=1))
        priors.append(usual_prior + math.log(share) + (links - 1) * math.log1p(-share))
    return np.concatenate(members), np.concatenate(priors)


def _pick(problem: Any, problems: int) -> Any:
    """What takes each box's problem from the last axis of an array (nothing to take of a single one)."""
    return (lambda values: values) if problems == 1 else (lambda values: values[..., problem])


def _log_prior(bit: Any, doubted: FloatArray, certain: FloatArray, model: SignalModel) -> FloatArray:
    """(S, N) log P(s) of each combination ``bit`` (S, D), the share of LOS links marginalised.

    ``model.los_shares`` are equally likely shares; a link's p is against even odds.
    """
    terms = []
    for share in model.los_shares:
        here = bit @ np.log(2.0 * share * doubted)
        here = here + (1 - bit) @ np.log(2.0 * (1.0 - share) * (1.0 - doubted))
        here += np.log(2.0 * (share * certain + (1.0 - share) * (1.0 - certain))).sum(axis=0)
        terms.append(here)
    return np.asarray(np.logaddexp.reduce(terms, axis=0) - np.log(len(terms)))
