"""Where the paper does not look: targets outside the ring, uneven rings, few vehicles, wide areas.

Exists because a method that shrinks to the middle looks good where targets fill a disc that
the vehicles surround. Rule: the rival of ``posterior`` is whichever other method is best on
that very case, the constant answer "the centre" among them.
"""

from __future__ import annotations

from sim_sitl.studies.cases import CASES
from sim_sitl.studies.study import Section, Shape, Study
from sim_sitl.studies.table4 import LOS_METHODS, MIXED_METHODS, NLOS_METHODS

_METHODS = {
    "LOS": (*(name for name in LOS_METHODS if name != "wls-ideal"), "lsre-socp"),
    "mixed": (*MIXED_METHODS, "lsre-socp"),
    "NLOS": NLOS_METHODS,
}


def _section(label: str, methods: tuple[str, ...]) -> Section:
    suffix = f"-{label.lower()}"
    cases = tuple(
        name for name, case in CASES.items() if case.environment == "hard" and name.endswith(suffix)
    )
    return Section(
        label.lower(), f"{label} links", cases, methods, Shape.RIVALS,
        note="`lsre-socp` is the weighted centroid (docs/methods.md).",
    )  # fmt: skip


HARD = Study(
    "hard",
    "Where the paper does not look",
    tuple(_section(label, methods) for label, methods in _METHODS.items()),
)
