"""N problems at once, and N answers: what every solver takes and gives.

Exists so that one code solves one snapshot and a study's thousands alike, in array
operations where a method allows it. Rule: a solver is a pure function of a ``Batch``; what it
cannot answer it marks in ``status`` with a NaN position, and never raises for one problem of
many. A single snapshot is a batch of one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import InputError
from groundstation.localization.problem import BoolArray, FloatArray, Links, SearchArea, SignalModel

if TYPE_CHECKING:
    from groundstation.localization.posterior import PosteriorAnswer

MINIMUM_DISTANCE_M = 1.0
"""Distances under it count as it: the log-distance model starts at one metre."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """N problems of K links each, in one area, under one signal model."""

    links: Links
    """With a leading axis N."""
    area: SearchArea
    """Where the targets may be."""
    model: SignalModel
    """What is assumed of the radio."""
    bias_max_db: FloatArray
    """(N,) b_max of each problem, dB: the model's unless a study draws it anew for each trial."""
    truth_enu_m: FloatArray | None = None
    """(N, 3) true places: for ``wls-ideal`` in a study, never in the service."""
    transmit_power_dbm: FloatArray | None = None
    """(N,) true transmit powers, dBm: for ``wls-ideal`` in a study that draws them anew."""

    @classmethod
    def of(
        cls,
        links: Links,
        area: SearchArea,
        model: SignalModel,
        bias_max_db: Any = None,
        truth_enu_m: FloatArray | None = None,
        transmit_power_dbm: FloatArray | None = None,
    ) -> Batch:
        """A batch of links with a leading axis N; b_max is the model's unless given as (N,)."""
        if links.position_enu_m.ndim != 3:
            raise InputError(
                f"locate_batch got positions of shape {links.position_enu_m.shape}; (N, K, 3) is needed"
            )
        count = links.position_enu_m.shape[0]
        bias_max_db = model.nlos_bias_max_db if bias_max_db is None else bias_max_db
        if np.ndim(bias_max_db) and np.shape(bias_max_db) != (count,):
            raise InputError(f"b_max has shape {np.shape(bias_max_db)}; ({count},) is needed")
        bias = np.full(count, bias_max_db, dtype=np.float64)
        if truth_enu_m is not None and np.shape(truth_enu_m) != (count, 3):
            raise InputError(f"true places have shape {np.shape(truth_enu_m)}; ({count}, 3) is needed")
        if transmit_power_dbm is not None and np.shape(transmit_power_dbm) != (count,):
            raise InputError(
                f"true transmit powers have shape {np.shape(transmit_power_dbm)}; ({count},) is needed"
            )
        return cls(links, area, model, bias, truth_enu_m, transmit_power_dbm)

    @property
    def size(self) -> int:
        """N."""
        return int(self.links.position_enu_m.shape[0])

    @property
    def place(self) -> FloatArray:
        """(N, K, 3) vehicle positions, metres ENU."""
        return self.links.position_enu_m

    def los(self) -> BoolArray:
        """(N, K) which links are labelled LOS."""
        return self.links.los(self.model.los_threshold)

    def bearing_usable(self) -> BoolArray:
        """(N, K) LOS-labelled links with both angles."""
        result: BoolArray = self.los() & self.links.has_angle()
        return result

    def received_dbm(self) -> FloatArray:
        """(N, K) received power without the receivers' common offset."""
        result: FloatArray = self.links.rss_dbm - self.model.receiver_offset_db
        return result

    def distances_m(self, position_enu_m: FloatArray) -> FloatArray:
        """(N, K) of (66) from positions (N, 3), not under one metre."""
        offset = self.place - position_enu_m[:, None, :]
        gap = np.sqrt(np.einsum("nki,nki->nk", offset, offset))
        result: FloatArray = np.maximum(gap, MINIMUM_DISTANCE_M)
        return result

    def first_power_dbm(self) -> FloatArray:
        """(N,) P̂_t before the first iteration."""
        known = self.model.known_transmit_power_dbm
        return np.full(self.size, self.model.first_transmit_power_dbm if known is None else known)

    def true_power_dbm(self) -> FloatArray | None:
        """(N,) transmit power where it is given: of each problem, or the model's; None: unknown."""
        if self.transmit_power_dbm is not None:
            return self.transmit_power_dbm
        known = self.model.known_transmit_power_dbm
        return None if known is None else np.full(self.size, known)

    def first_exponents(self) -> FloatArray:
        """(N, K) β̂ before the first iteration: β_LOS, or the first NLOS exponent."""
        return np.where(self.los(), self.model.los_exponent, self.model.first_exponent)

    def rss_cost_db2(self, position: FloatArray, power_dbm: FloatArray, exponent: FloatArray) -> FloatArray:
        """(N,) J of (69): squared residuals of the unshifted powers, dB²."""
        path = 10.0 * exponent * np.log10(self.distances_m(position))
        result: FloatArray = np.square(self.received_dbm() - power_dbm[:, None] + path).sum(axis=1)
        return result

    def rows(self, chosen: Any) -> Batch:
        """The problems that ``chosen`` (mask or indices) selects."""
        truth = None if self.truth_enu_m is None else self.truth_enu_m[chosen]
        power = None if self.transmit_power_dbm is None else self.transmit_power_dbm[chosen]
        return replace(
            self, links=self.links.subset(chosen), bias_max_db=self.bias_max_db[chosen], truth_enu_m=truth,
            transmit_power_dbm=power,
        )  # fmt: skip

    def with_links(self, columns: Any) -> Batch:
        """The same problems with the links ``columns`` (N, k) of each."""
        return replace(self, links=self.links.take(columns))


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """N answers of one solver. A problem it could not answer: position NaN, ``status`` says why."""

    position_enu_m: FloatArray
    """(N, 3) metres."""
    transmit_power_dbm: FloatArray
    """(N,) P̂_t; NaN where the method does not estimate it."""
    path_loss_exponent: FloatArray
    """(N, K) β̂ of each link."""
    iterations: Any
    """(N,) int: rounds of the outer iteration, 1 for a closed form."""
    status: Sequence[str]
    """N times ``ok``, ``iteration limit``, ``diverging``, or what went wrong."""
    covariance_m2: FloatArray | None = None
    """(N, 3, 3) where the method has one of its own; None: the posterior's spread about the answer."""
    beliefs: Sequence[PosteriorAnswer | None] | None = None
    """N beliefs over position, of ``posterior`` only."""

    @classmethod
    def closed_form(
        cls, batch: Batch, position: FloatArray, power: FloatArray, exponent: FloatArray
    ) -> Answers:
        """Answers of a method without iterations: ``ok`` wherever the position is finite."""
        bad = np.flatnonzero(~np.isfinite(position).all(axis=1))
        status = ["ok"] * batch.size
        for row in bad:
            status[row] = "no finite answer"
        return cls(position, power, exponent, np.ones(batch.size, dtype=np.int64), status)


Solver = Callable[[Batch], Answers]


def selected(which: BoolArray) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Problems with equally many chosen links ``which`` (N, K): their rows, and the links' columns (n, k)."""
    order = np.argsort(~which, axis=1, kind="stable")
    counts = which.sum(axis=1)
    for number in np.unique(counts):
        rows = np.flatnonzero(counts == number)
        yield rows, order[rows, :number]


def scattered(size: int, links: int, parts: Sequence[tuple[Any, Answers]]) -> Answers:
    """Answers of a batch put together from ``parts``: (row numbers, their answers); others are NaN."""
    position = np.full((size, 3), np.nan)
    power = np.full(size, np.nan)
    exponent = np.full((size, links), np.nan)
    iterations = np.zeros(size, dtype=np.int64)
    status = ["not solved"] * size
    covariance: FloatArray | None = None
    beliefs: list[PosteriorAnswer | None] = [None] * size
    for rows, part in parts:
        position[rows], power[rows] = part.position_enu_m, part.transmit_power_dbm
        exponent[rows], iterations[rows] = part.path_loss_exponent, part.iterations
        if part.covariance_m2 is not None:
            covariance = np.full((size, 3, 3), np.nan) if covariance is None else covariance
            covariance[rows] = part.covariance_m2
        for number, row in enumerate(rows):
            status[row] = part.status[number]
            if part.beliefs is not None:
                beliefs[row] = part.beliefs[number]
    any_belief = any(belief is not None for belief in beliefs)
    return Answers(position, power, exponent, iterations, status, covariance, beliefs if any_belief else None)
