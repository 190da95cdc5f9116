"""The paper's Figs. 3 to 10: RMSE over vehicles and radius, and the end-to-end distribution.

Rule: where the paper marks one point of a curve in Table IV, that point alone is set beside
ours; the curves themselves are not published as numbers.
"""

from __future__ import annotations

from sim_sitl.studies import paper
from sim_sitl.studies.study import Axis, Section, Shape, Study
from sim_sitl.studies.table4 import END_TO_END_METHODS, LOS_METHODS, MIXED_METHODS, NLOS_METHODS

VEHICLES = (4, 5, 6, 7)
RADII_M = (100, 200, 300, 400)
_RUBBLE = "NLOS, the paper's construction with values of ours"


def _over_vehicles(
    key: str, title: str, case: str, methods: tuple[str, ...], note: str = "", environment: str | None = None
) -> Section:
    return Section(
        key, title, tuple(f"{case}-k{count}" for count in VEHICLES), methods, Shape.SERIES,
        Axis("vehicles K", tuple(float(count) for count in VEHICLES)), note, environment,
        None if environment is None else f"{case}-k4",
    )  # fmt: skip


def _over_radius(
    key: str, title: str, case: str, methods: tuple[str, ...], note: str = "", environment: str | None = None
) -> Section:
    # K = 4, R₀ = 100 m is the same case on both axes.
    names = tuple(f"{case}-k4" if radius == 100 else f"{case}-r{radius}" for radius in RADII_M)
    return Section(
        key, title, names, methods, Shape.SERIES,
        Axis("radius R₀, m", tuple(float(radius) for radius in RADII_M)), note, environment,
        None if environment is None else names[0],
    )  # fmt: skip


def _distribution(key: str, title: str, note: str = "", environment: str | None = None) -> Section:
    case = f"end-to-end-{key}"
    shares = paper.SHARES_ZERO if key == "rows-zero" else paper.SHARES
    return Section(
        key, title, (case,), END_TO_END_METHODS, Shape.DISTRIBUTION, None, f"{shares} {note}".strip(),
        environment, None if environment is None else case,
    )  # fmt: skip


FIGURES: tuple[Study, ...] = (
    Study(
        "fig3", "Fig. 3: LOS, σ_θ = σ_φ = 1°, over the number of vehicles, R₀ = 100 m",
        (_over_vehicles("los", "LOS, 1°", "los", LOS_METHODS, paper.NOTES["LOS"], "LOS"),),
    ),
    Study(
        "fig4", "Fig. 4: LOS, σ_θ = σ_φ = 1°, over the radius, K = 4",
        (_over_radius("los", "LOS, 1°", "los", LOS_METHODS, paper.NOTES["LOS"], "LOS"),),
    ),
    Study(
        "fig5", "Fig. 5: LOS, σ_θ = σ_φ = 3°, over the number of vehicles, R₀ = 100 m",
        (_over_vehicles("los", "LOS, 3°", "los-3deg", LOS_METHODS),),
    ),
    Study(
        "fig6", "Fig. 6: LOS, σ_θ = σ_φ = 3°, over the radius, K = 4",
        (_over_radius("los", "LOS, 3°", "los-3deg", LOS_METHODS),),
    ),
    Study(
        "fig7", "Fig. 7: NLOS, over the number of vehicles, R₀ = 100 m",
        (
            _over_vehicles("eq8", "NLOS, eq. (8)", "nlos", NLOS_METHODS),
            _over_vehicles("paper", _RUBBLE, "nlos-rubble", NLOS_METHODS, paper.NOTES["NLOS"], "NLOS"),
        ),
    ),
    Study(
        "fig8", "Fig. 8: NLOS, over the radius, K = 4",
        (
            _over_radius("eq8", "NLOS, eq. (8)", "nlos", NLOS_METHODS),
            _over_radius("paper", _RUBBLE, "nlos-rubble", NLOS_METHODS, paper.NOTES["NLOS"], "NLOS"),
        ),
    ),
    Study(
        "fig9", "Fig. 9: mixed, over the radius, K = 4",
        (_over_radius("mixed", "One LOS link", "mixed", MIXED_METHODS, paper.NOTES["mixed"], "mixed"),),
    ),
    Study(
        "fig10", "Fig. 10: distribution of the error end to end, K = 4",
        (
            _distribution("analytic", "Power by eqs. (7) and (8), geometry of V-C"),
            _distribution("ring", "The cluster model's power, geometry of V-C"),
            _distribution("rows", "Four rows of the data set (V-D)", paper.NOTES["end to end"], "end to end"),
            _distribution(
                "rows-zero", "The same, NLOS angles reported as zero, as in the paper's rows",
                paper.NOTES["end to end"], "end to end",
            ),
        ),
    ),
)  # fmt: skip
