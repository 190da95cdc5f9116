"""Windows as a filter over time takes them: each conditioned on the newest ones before it.

Exists because a walker's filter, unlike the still belief, cannot go back to old windows: the
person was elsewhere then. Rules: same rows and same whitening as the still belief's (``history``,
``whitening.whiten``), with the newest window of each vehicle as the only past; whoever stands still
must, besides, be heard as before from where a vehicle has been before. That alone tells most who walk by
power alone from those who do not. It is asked of a vehicle's own windows only: how far vehicles
share their shadowing is known too badly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.localization.whitening import Observations, Whitened, whiten
from groundstation.tracking.history import LINK, RSS, TIME, WHITE, History, TrackObservation, observations_of
from groundstation.tracking.settings import TrackingSettings

_FOREIGN = 2
_AGAIN = 2
"""Of a vehicle's earlier windows so many foretell one that it takes where it has been before."""


@dataclass(slots=True, eq=False)
class Windows:
    """n windows in order, as rows of numbers (``History.row``)."""

    rows: FloatArray
    """(n, columns)"""
    time_s: FloatArray
    """(n,) end of each, station seconds."""

    @property
    def count(self) -> int:
        """n."""
        return int(self.time_s.size)

    @classmethod
    def of(cls, windows: list[TrackObservation], history: History) -> Windows:
        """Of those that tell anything; ``history`` numbers the vehicles and is not added to."""
        rows = [(history.row(window), window.time_s) for window in windows]
        table = [row for row, _ in rows if row is not None]
        return cls(
            np.array(table) if table else np.zeros((0, 1)),
            np.array([time_s for row, time_s in rows if row is not None], dtype=np.float64),
        )

    def take(self, chosen: Any) -> Windows:
        """The windows that ``chosen`` selects."""
        return Windows(self.rows[chosen], self.time_s[chosen])

    def then(self, new: Windows) -> Windows:
        """These and, after them, ``new``."""
        if not self.count:
            return new
        return Windows(np.concatenate([self.rows, new.rows]), np.concatenate([self.time_s, new.time_s]))

    def widened(self, chosen: Any, variance_db2: FloatArray) -> Windows:
        """With more white noise on the power of the ``chosen`` ones."""
        rows = self.rows.copy()
        rows[chosen, WHITE] += variance_db2
        return Windows(rows, self.time_s)

    def observations(self) -> Observations:
        """As the likelihood wants them; none related to another."""
        return observations_of(self.rows, np.full((self.count, 0), -1, dtype=np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class Related:
    """New windows and those that they are conditioned on."""

    every: Observations
    """Past and new windows, one after the other."""
    past: int
    """How many belong to the past; those of earlier visits come after them."""
    first: int
    """Number of the first new one."""
    whitened: Whitened
    """Of the new ones with power."""
    family: Any
    """(r, 1 + m) numbers in ``every``: the row itself and its parents (0 with no weight: none)."""
    late_s: FloatArray
    """(new,) how long before the newest each ended."""


def visits(rows: FloatArray, links: Any, past: Windows, new: Windows, correlation_m: float) -> Windows:
    """The windows among ``rows`` (n, columns) that each of ``new`` repeats, for ``related``; often none.

    ``links`` (vehicles of ``rows``,) their numbers in ``new``, -1: none. A place is visited again where
    an older window of the vehicle was near (a third of ``correlation_m``), and nearer than its newest in
    ``past``: one who hovers visits nothing.
    """
    reach2 = (correlation_m / 3.0) ** 2
    nothing = Windows(new.rows[:0], new.time_s[:0])
    if not (rows.size and past.count):
        return nothing
    link = links[rows[:, LINK].astype(np.int64)]
    chosen: list[Any] = []
    for row in new.rows:
        mine = np.flatnonzero(past.rows[:, LINK] == row[LINK])
        if not mine.size:
            continue
        limit2 = min(float(np.square(past.rows[mine[-1], :3] - row[:3]).sum()), reach2)
        older = np.flatnonzero((link == row[LINK]) & (rows[:, TIME] < past.time_s[mine[-1]]))
        gap2 = np.square(rows[older, :3] - row[:3]).sum(axis=1)
        gap2[~np.isfinite(rows[older, RSS])] = np.inf
        near = np.argsort(gap2, kind="stable")[:_AGAIN]
        chosen.append(older[near[gap2[near] < limit2]])
    number = np.unique(np.concatenate(chosen)) if chosen else np.zeros(0, dtype=np.int64)
    if not number.size:
        return nothing
    told = rows[number].copy()
    told[:, LINK] = link[number]
    return Windows(told, told[:, TIME].copy())


def related(
    past: Windows,
    new: Windows,
    links: int,
    pace_mps: float,
    model: SignalModel,
    settings: TrackingSettings,
    again: Windows | None = None,
) -> Related:
    """Condition ``new`` on ``past``, the newest window of each vehicle, and on each other.

    ``pace_mps`` makes time count as distance: shadowing changes with the person's steps too. ``again``:
    older windows from the same places (``visits``), of a person who took no steps since.
    """
    older = 0 if again is None else again.count
    every = past if again is None or not older else past.then(again)
    every, first = every.then(new), every.count
    plain = every.observations()
    newest_s = float(every.time_s.max())
    place = np.column_stack([plain.position_enu_m, pace_mps * (every.time_s - newest_s)])
    own = np.arange(first, every.count)
    number = np.arange(every.count)
    visited = (number >= past.count) & (number < first)
    place[visited, 3] = 0.0
    before = (number < own[:, None]) & ~visited
    same = plain.link == plain.link[own, None]
    usable = before & np.isfinite(plain.rss_dbm)
    gap2 = np.square(place[own, None] - place).sum(axis=-1)
    parents = np.where(usable & same, number, -1).max(axis=1, keepdims=True)
    if model.shared_shadowing > 0.0 and links > 1:
        away = np.where(usable & ~same, gap2, np.inf)
        near = np.argsort(away, axis=1, kind="stable")[:, :_FOREIGN]
        near = np.where(np.isfinite(np.take_along_axis(away, near, axis=1)), near, -1)
        parents = np.concatenate([parents, near], axis=1)
    if older:
        away = np.where(visited & same, gap2, np.inf)
        near = np.argsort(away, axis=1, kind="stable")[:, :_AGAIN]
        near = np.where(np.isfinite(np.take_along_axis(away, near, axis=1)), near, -1)
        parents = np.concatenate([parents, near], axis=1)
    table = np.full((every.count, parents.shape[1]), -1, dtype=np.int64)
    table[first:] = parents
    # Whether a bearing is genuine is news as far as the way is another than that of the last one.
    told = before & same & np.isfinite(plain.azimuth_rad)
    gap = np.sqrt(np.where(told, gap2, np.inf).min(axis=1, initial=np.inf))
    weight = plain.angle_weight.copy()
    weight[first:] = np.maximum(-np.expm1(-2.0 * gap / settings.correlation_m), 0.02)
    full = replace(plain, position_enu_m=place, parents=table, angle_weight=weight)
    rows = whiten(full, first, links, settings.correlation_m, model)
    chosen = table[rows.rows]
    family = np.concatenate([rows.rows[:, None], np.where(chosen >= 0, chosen, 0)], axis=1)
    return Related(
        replace(full, position_enu_m=plain.position_enu_m),
        past.count,
        first,
        rows,
        family,
        newest_s - every.time_s[first:],
    )


def latest(windows: list[TrackObservation]) -> list[TrackObservation]:
    """Of each vehicle the newest window with power, else with a bearing; vehicles in order of their first."""
    chosen: dict[int, TrackObservation] = {}
    for window in windows:
        before = chosen.get(window.vehicle_id)
        if before is None or _told(window) >= _told(before):
            chosen[window.vehicle_id] = window
    return list(chosen.values())


def _told(window: TrackObservation) -> int:
    if window.rss_dbm is not None:
        return 2
    return int(window.azimuth_rad is not None)


def newest(windows: Windows, links: int) -> Windows:
    """The newest window of each vehicle with power, or else with a bearing; in order of the vehicles."""
    number = np.arange(windows.count) + windows.count * np.isfinite(windows.rows[:, RSS])
    best = np.full(links, -1, dtype=np.int64)
    np.maximum.at(best, windows.rows[:, LINK].astype(np.int64), number)
    return windows.take(best[best >= 0] % windows.count)
