"""The iteration (66)–(70) of the paper round a solver of the position, for N problems at once.

Exists because three methods differ only in the program that gives the position (LSRE–SOCP,
LSRE–SDP, RWLS–SDP). Rules: the stopping rules are the paper's, with the tolerances of
``SignalModel``; a problem that has stopped is not computed again; what the rounds of one
problem give does not depend on the others in the batch.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groundstation.localization.batch import Answers, Batch
from groundstation.localization.problem import FloatArray

SMALLEST_EXPONENT = 0.1
"""(68) at a low P̂_t turns to zero and below, where 10^(1/β) has no meaning: β̂ stops here."""
_RISE_DB2 = 1e-9

Positions = Callable[[Batch, FloatArray, FloatArray], FloatArray]
"""Problems, P̂_t (N,), β̂ (N, K) → places (N, 3), metres; NaN where the program has no answer."""


def updated_power_and_exponents(
    batch: Batch,
    position_enu_m: FloatArray,
    power_dbm: FloatArray,
    exponent: FloatArray,
    *,
    every_link: bool = False,
    relaxation: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """P̂_t (N,) and β̂ (N, K) after (67), (70) and (68) at positions (N, 3).

    Links labelled LOS keep β_LOS, as said under (72), unless ``every_link``: (68) as printed
    knows no labels. At one metre (68) divides by zero: that link's exponent stays. A known
    P_t stays too. ``relaxation``: ν of (70), the model's unless given; 1 is (67) as it stands.
    """
    received = batch.received_dbm()
    log_distance = np.log10(batch.distances_m(position_enu_m))
    if batch.model.known_transmit_power_dbm is None:
        averaged = (received + 10.0 * exponent * log_distance).mean(axis=1)
        nu = batch.model.relaxation if relaxation is None else relaxation
        power_dbm = power_dbm + nu * (averaged - power_dbm)
    adjustable = (log_distance > 1e-6) & (every_link | ~batch.los())
    fitted = (power_dbm[:, None] - received) / (10.0 * np.where(adjustable, log_distance, 1.0))
    return power_dbm, np.where(adjustable, np.maximum(fitted, SMALLEST_EXPONENT), exponent)


def alternate(
    batch: Batch, positions: Positions, *, every_link: bool = False, relaxation: float | None = None
) -> Answers:
    """``positions``, then (66)–(70), until a stopping rule of the paper holds.

    ``ok``: the place moved less than ε_x, or P̂_t less than ε_Pt and β̂ (as a vector) less than
    ε_PLE; ``diverging``: J of (69) rose ``diverging_rounds`` times running; else ``iteration
    limit``. The P̂_t and β̂ returned are those fitted at the place returned. ``every_link`` and
    ``relaxation``: see ``updated_power_and_exponents``.
    """
    model = batch.model
    count = batch.size
    place = np.full((count, 3), np.nan)
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    cost, rises = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    rounds = np.zeros(count, dtype=np.int64)
    status = np.full(count, "iteration limit", dtype=object)
    active = np.arange(count)
    for number in range(1, int(model.maximum_iterations) + 1):
        part = batch if active.size == count else batch.rows(active)
        found = positions(part, power[active], exponent[active])
        solved = np.isfinite(found).all(axis=1)
        new_power, new_exponent = updated_power_and_exponents(
            part, found, power[active], exponent[active], every_link=every_link, relaxation=relaxation
        )
        new_cost = part.rss_cost_db2(found, new_power, new_exponent)
        rises[active] = np.where(new_cost > cost[active] + _RISE_DB2, rises[active] + 1, 0)
        moved = np.linalg.norm(found - place[active], axis=1)
        steady = np.abs(new_power - power[active]) < model.transmit_power_tolerance_db
        steady &= np.linalg.norm(new_exponent - exponent[active], axis=1) < model.exponent_tolerance
        settled = steady if number == 1 else steady | (moved < model.position_tolerance_m)
        diverging = rises[active] >= model.diverging_rounds
        rounds[active], place[active] = number, found
        power[active], exponent[active], cost[active] = new_power, new_exponent, new_cost
        status[active[diverging]] = "diverging"
        status[active[settled]] = "ok"
        status[active[~solved]] = "no finite answer"
        active = active[solved & ~settled & ~diverging]
        if not active.size:
            break
    return Answers(place, power, exponent, rounds, list(status))
