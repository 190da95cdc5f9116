"""LSRE–SOCP as printed, (64), and its iteration as printed, (66)–(70).

Exists to keep the paper's method by its name, with its defects. (64) bounds y from below only:
the reciprocal term costs nothing, and with ζ fixed by P̂_t what is left is min Σ w_k‖x − a_k‖²,
w_k = c_k² g_k. That is isotropic, so its optimum over height limits and search area is the
Euclidean projection of the weighted centroid onto them, in closed form (convex area or not);
the tests solve the printed program with a conic solver and find the same place. With one
common β the place does not depend on P̂_t, and its height ends on the cap. After (68) every
refitted link's residual in (69) is zero, whatever the place. Rule: nothing is mended here.
The shifted powers P̂_r enter (64), the unshifted P_r (67)–(69), both as printed.
"""

from __future__ import annotations

from groundstation.localization.alternation import alternate
from groundstation.localization.batch import Answers, Batch
from groundstation.localization.lsre_terms import weighted_centroid
from groundstation.localization.problem import FloatArray


def literal_positions(batch: Batch, power_dbm: FloatArray, exponent: FloatArray) -> FloatArray:
    """(N, 3) metres: the optimum of (64), (73), at P̂_t (N,) and β̂ (N, K), within heights and area."""
    return batch.area.clip(weighted_centroid(batch, power_dbm, exponent))


def lsre_socp(batch: Batch) -> Answers:
    """One solve of (64), (73) at the first P̂_t and β̂."""
    power, exponent = batch.first_power_dbm(), batch.first_exponents()
    return Answers.closed_form(batch, literal_positions(batch, power, exponent), power, exponent)


def lsre_socp_iterative(batch: Batch, *, every_link: bool = False) -> Answers:
    """(64) and (66)–(70) in turn with the paper's stopping rules; see the module's header.

    ``every_link``: (68) refits links labelled LOS too, as (66)–(69) are printed for every k.
    """
    return alternate(batch, literal_positions, every_link=every_link)
