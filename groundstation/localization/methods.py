"""What a method declares, and the one place that refuses what it cannot work on.

Exists so that ``locate``, the studies, the documentation and the benchmarks read the same
facts about a method. Rule: what a method needs is declared here and refused here, in one
wording: what was seen and what is needed; a solver itself sees only problems that it can
work on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import InputError
from groundstation.localization.batch import Answers, Batch, Solver, scattered

_ONE_PLACE_M = 1.0


@dataclass(frozen=True, slots=True)
class Method:
    """One solver."""

    solve: Solver
    """The solver itself; sees only problems that pass the needs below."""
    equations: str
    """What it implements, one line: equations of the paper, or where it comes from."""
    links: int = 1
    """Fewest links; from two on, the vehicles must not all be in one place."""
    bearings: int = 0
    """Fewest LOS-labelled links with both angles."""
    nlos_links: int = 0
    """Fewest links labelled NLOS."""
    nlos_bearings: int = 0
    """Fewest links labelled NLOS that report both angles."""
    known_power: bool = False
    """Whether the model must know the transmit power."""

    def needs(self) -> str:
        """The needs in words, for documentation and help."""
        parts = [f"{self.links} link{'s' if self.links > 1 else ''}"]
        if self.bearings:
            parts.append(f"{self.bearings} LOS with angles")
        if self.nlos_links:
            parts.append(f"{self.nlos_links} NLOS")
        if self.nlos_bearings:
            parts.append(f"{self.nlos_bearings} NLOS with angles")
        if self.known_power:
            parts.append("transmit power")
        return ", ".join(parts)


def refusals(name: str, method: Method, batch: Batch) -> list[str]:
    """N messages: why ``method`` cannot work on a problem; empty where it can.

    Raises InputError for the one thing that a whole batch lacks: the transmit power.
    """
    if method.known_power and batch.true_power_dbm() is None:
        raise InputError(
            f"{name} got no transmit power; it needs the true one"
            " (transmit_power_dbm, or SignalModel.known_transmit_power_dbm)"
        )
    count = batch.links.count
    if count < method.links:
        return [f"{name} got {count} link(s); it needs {method.links} or more"] * batch.size
    place, rss, p = batch.place, batch.links.rss_dbm, batch.links.los_probability
    with np.errstate(invalid="ignore"):
        spread = np.abs(place[:, 1:] - place[:, :1]).max(axis=(1, 2), initial=0.0)
    finite = np.isfinite(place).all(axis=(1, 2)) & np.isfinite(rss).all(axis=1)
    suspects = ~finite | ((p < 0.0) | (p > 1.0)).any(axis=1)
    if method.links > 1:
        suspects |= ~(spread >= _ONE_PLACE_M)
    seen = _counts(method, batch)
    for number, needed, _ in seen:
        suspects |= number < needed
    messages = [""] * batch.size
    for row in np.flatnonzero(suspects).tolist():
        messages[row] = _wrong_link(batch, row)
        if not messages[row] and method.links > 1 and not spread[row] >= _ONE_PLACE_M:
            messages[row] = (
                f"all {count} vehicles are within {spread[row]:.2f} m of one place;"
                f" {name} needs two or more places"
            )
        if not messages[row]:
            number, needed, what = next(item for item in seen if item[0][row] < item[1])
            messages[row] = f"{name} got {number[row]} {what}; it needs {needed} or more"
    return messages


def _counts(method: Method, batch: Batch) -> list[tuple[NDArray[np.int64], int, str]]:
    """For each need of the method: (N,) how many there are, how many are needed, of what."""
    if not (method.bearings or method.nlos_links or method.nlos_bearings):
        return []
    los, bearing = batch.los(), batch.links.has_angle()
    every = (
        (los & bearing, method.bearings, "line-of-sight link(s) with angles"),
        (~los, method.nlos_links, "link(s) labelled NLOS"),
        (~los & bearing, method.nlos_bearings, "link(s) labelled NLOS with angles"),
    )
    return [(which.sum(axis=1), needed, what) for which, needed, what in every if needed]


def _wrong_link(batch: Batch, row: int) -> str:
    """What is wrong with the values of a link of one problem; empty where nothing is."""
    place, rss = batch.place[row], batch.links.rss_dbm[row]
    p = batch.links.los_probability[row]
    for wrong, message in (
        (~np.isfinite(place).all(axis=1), "vehicle position of link {} is not finite; ENU metres are needed"),
        (~np.isfinite(rss), "received power of link {} is not finite; dBm is needed"),
        ((p < 0.0) | (p > 1.0), "P(line of sight) of link {} is {}; 0 to 1 is needed"),
    ):
        if wrong.any():
            link = int(np.argmax(wrong))
            return message.format(link, p[link])
    return ""


def solve(name: str, method: Method, batch: Batch) -> Answers:
    """Answers of ``method``; what it cannot work on has a NaN position and a status that says why."""
    messages = refusals(name, method, batch)
    if batch.size and not any(messages):
        return method.solve(batch)
    fine = np.array([not message for message in messages], dtype=bool)
    parts = [(np.flatnonzero(fine), method.solve(batch.rows(fine)))] if fine.any() else []
    answers = scattered(batch.size, batch.links.count, parts)
    status = [message or answers.status[row] for row, message in enumerate(messages)]
    return replace(answers, status=status)
