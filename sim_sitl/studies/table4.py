"""The paper's Table IV: every method in LOS, NLOS, mixed and end to end, beside paper and limit.

K = 4, R₀ = 100 m. Rule: eq. (8) and the paper's own NLOS construction are two sections; the
paper's figures stand in the second alone.
"""

from __future__ import annotations

from sim_sitl.studies import paper
from sim_sitl.studies.study import Section, Study

LOS_METHODS = (
    "wls-ideal", "wls-taylor", "sdp-socp", "sr-wls", "wls-taylor-bounded", "posterior", "centre",
)  # fmt: skip
NLOS_METHODS = (
    "rwls-sdp", "lsre-sdp-iterative", "lsre-socp-iterative", "lsre-sdp", "lsre-socp", "lsre-ccp", "posterior",
    "centre",
)  # fmt: skip
MIXED_METHODS = (
    "rwls-sdp", "lsre-sdp-iterative", "lsre-socp-iterative", "1aoa-nrss", "projection-3nlos",
    "angle-reconstruction", "projection-label-aware-literal", "projection-label-aware", "lsre-ccp",
    "posterior", "centre",
)  # fmt: skip
END_TO_END_METHODS = (
    "rwls-sdp", "lsre-sdp-iterative", "lsre-socp-iterative", "adaptive", "adaptive-sound", "posterior",
    "centre",
)  # fmt: skip

TABLE4 = Study(
    "table4",
    "Table IV: methods in each environment, K = 4, R₀ = 100 m",
    (
        Section(
            "los", "LOS environment", ("los-k4",), LOS_METHODS,
            note=paper.NOTES["LOS"], paper="LOS", paper_case="los-k4",
        ),
        Section(
            "nlos-eq8", "NLOS environment, eq. (8)", ("nlos-k4",), NLOS_METHODS,
            note="Eq. (8): one β ~ U(2, 3.5) a trial, b ~ U(0, 7) dB a link. The paper has no figure on it.",
        ),
        Section(
            "nlos-paper", "NLOS environment, the paper's construction with values of ours",
            ("nlos-rubble-k4",), NLOS_METHODS,
            note=paper.NOTES["NLOS"], paper="NLOS", paper_case="nlos-rubble-k4",
        ),
        Section(
            "mixed", "Mixed environment", ("mixed-k4",), MIXED_METHODS,
            note=paper.NOTES["mixed"], paper="mixed", paper_case="mixed-k4",
        ),
        Section(
            "end-to-end-analytic", "End to end: power by eqs. (7) and (8), geometry of V-C",
            ("end-to-end-analytic",), END_TO_END_METHODS,
            note=paper.SHARES + " Power is analytic here: the paper has no figure on it.",
        ),
        Section(
            "end-to-end-ring", "End to end: the cluster model's power, geometry of V-C",
            ("end-to-end-ring",), END_TO_END_METHODS,
            note=paper.SHARES + " The paper has no figure on this geometry.",
        ),
        Section(
            "end-to-end-rows", "End to end: four rows of the data set (V-D)",
            ("end-to-end-rows",), END_TO_END_METHODS,
            note=f"{paper.SHARES} {paper.NOTES['end to end']}", paper="end to end",
            paper_case="end-to-end-rows",
        ),
    ),
)  # fmt: skip
