"""The list of solvers: each name of the interface, its solver, its equations and its needs.

Exists apart from ``methods`` so that solvers may import the words of that module, and apart
from the solvers so that the list is read at one glance. Rule: order and names are the
interface's; ``docs/methods.md`` describes each, and a test holds the two together.
"""

from __future__ import annotations

from groundstation.localization.baselines.angle_reconstruction import angle_reconstruction
from groundstation.localization.baselines.lsre_sdp import lsre_sdp, lsre_sdp_iterative
from groundstation.localization.baselines.one_aoa_nrss import one_aoa_nrss
from groundstation.localization.baselines.projection_3nlos import projection_3nlos
from groundstation.localization.baselines.rwls_sdp import rwls_sdp
from groundstation.localization.baselines.sdp_socp import sdp_socp
from groundstation.localization.baselines.sr_wls import sr_wls
from groundstation.localization.lsre_literal import lsre_socp, lsre_socp_iterative
from groundstation.localization.lsre_sound import lsre_ccp
from groundstation.localization.methods import Method
from groundstation.localization.posterior import posterior_batch
from groundstation.localization.projection import projection_label_aware, projection_label_aware_literal
from groundstation.localization.wls import wls_ideal, wls_taylor, wls_taylor_bounded

SOLVERS: dict[str, Method] = {
    "wls-taylor": Method(wls_taylor, "(30)–(51)", links=2, bearings=2),
    "wls-taylor-bounded": Method(
        wls_taylor_bounded, "(30)–(51) within height limits and search area", links=2, bearings=2
    ),
    "wls-ideal": Method(
        wls_ideal, "(30)–(51), true P_t, Jacobians at the true place", links=2, bearings=2, known_power=True
    ),
    "sdp-socp": Method(sdp_socp, "ranges at a fixed P_t and bearings, relaxed (V-C)", links=2, bearings=2),
    "sr-wls": Method(sr_wls, "squared ranges and bearings, global optimum (V-C)", links=2, bearings=2),
    "rwls-sdp": Method(rwls_sdp, "robust WLS by SDP, (67)–(68) (V-C)", links=3),
    "lsre-sdp": Method(lsre_sdp, "(62)–(63), once", links=3),
    "lsre-sdp-iterative": Method(lsre_sdp_iterative, "(62)–(63), (66)–(70)", links=3),
    "lsre-socp": Method(lsre_socp, "(64) as printed, once", links=3),
    "lsre-socp-iterative": Method(lsre_socp_iterative, "(64), (66)–(70) as printed", links=3),
    "lsre-ccp": Method(lsre_ccp, "(60) by the convex–concave procedure", links=3),
    "1aoa-nrss": Method(
        one_aoa_nrss, "mean NLOS bearing met with the ray (71) (V-C)", links=2, bearings=1, nlos_bearings=1
    ),
    "projection-3nlos": Method(
        projection_3nlos, "(64), (66)–(70) on NLOS links; (71), (74)–(75)", links=3, bearings=1, nlos_links=2
    ),
    "angle-reconstruction": Method(
        angle_reconstruction,
        "(64), (66)–(70) on NLOS links; (30)–(51)",
        links=3,
        bearings=1,
        nlos_links=2,
    ),
    "projection-label-aware": Method(projection_label_aware, "(71)–(76), test mended", links=3, bearings=1),
    "projection-label-aware-literal": Method(
        projection_label_aware_literal, "(71)–(76) as printed", links=3, bearings=1
    ),
    "posterior": Method(posterior_batch, "posterior mean, nuisances marginalised (ours)"),
}
