"""Label-aware projection onto the one LOS ray, eqs. (71)–(76): as printed, and mended.

Exists because one trusted bearing is worth more than three powers through rubble. As
printed, J of (76) is taken after (68) has made every residual zero, so the test accepts
nothing. Mended test: both candidates are judged by the same fit – power and one
shared NLOS exponent refitted at each, with their priors – and the projection is taken unless
it raises the misfit by more than what the two coordinates that it gives up explain (the 99 %
point of χ² with two degrees of freedom). The mended ray also ends where the target's height
limits end it: the paper's ray (74) may run on under the ground.
"""

from __future__ import annotations

import numpy as np

from groundstation.localization.lsre import (
    LsreAnswer,
    distances_m,
    lsre_socp,
    lsre_socp_iterative,
    received_dbm,
    refit_power_and_exponent,
    rss_cost_db2,
)
from groundstation.localization.problem import FloatArray, Links, SearchArea, SignalModel

_CHI2_TWO_99 = 9.21


def ray_direction(links: Links, index: int) -> FloatArray:
    """(3,) unit vector δ of (71)."""
    azimuth, elevation = links.azimuth_rad[index], links.elevation_rad[index]
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def los_anchor(links: Links, model: SignalModel) -> int | None:
    """The LOS-labelled link with angles that is most surely LOS; None when there is none."""
    usable = links.los(model.los_threshold) & links.has_angle()
    if not usable.any():
        return None
    return int(np.argmax(np.where(usable, np.nan_to_num(links.los_probability), -1.0)))


def project(links: Links, index: int, position: FloatArray) -> FloatArray:
    """(74)–(75): the nearest point of the ray."""
    origin, direction = links.position_enu_m[index], ray_direction(links, index)
    along = max(0.0, float((position - origin) @ direction))
    result: FloatArray = origin + along * direction
    return result


def project_within_heights(links: Links, index: int, position: FloatArray, area: SearchArea) -> FloatArray:
    """The nearest point of the ray's stretch between the target's height limits, inside the area."""
    origin, direction = links.position_enu_m[index], ray_direction(links, index)
    along = max(0.0, float((position - origin) @ direction))
    if abs(direction[2]) > 1e-3:
        ends = sorted(
            (height - origin[2]) / direction[2] for height in (area.height_min_m, area.height_max_m)
        )
        if ends[1] > 0.0:
            along = min(max(along, ends[0]), ends[1])
    inside: FloatArray = area.clip((origin + along * direction)[None])[0]
    return inside


def misfit(links: Links, position: FloatArray, model: SignalModel) -> float:
    """χ² of the powers at ``position``, power and a shared NLOS exponent refitted with their priors."""
    power, exponent = refit_power_and_exponent(links, position, model)
    los = links.los(model.los_threshold)
    shift = np.where(los, 0.0, 0.5 * model.nlos_bias_max_db)
    noise = np.where(
        los, model.rss_std_db, np.hypot(model.nlos_rss_std_db, model.nlos_bias_max_db / np.sqrt(12.0))
    )
    expected = power - 10.0 * exponent * np.log10(distances_m(links, position)) - shift
    value = float(np.square((received_dbm(links, model) - expected) / noise).sum())
    exponent_std = max((model.nlos_exponent_max - model.nlos_exponent_min) / np.sqrt(12.0), 1e-6)
    value += ((power - model.transmit_power_mean_dbm) / max(model.transmit_power_std_db, 1e-6)) ** 2
    if (~los).any():
        value += ((exponent[~los][0] - model.first_exponent) / exponent_std) ** 2
    return value


def projection_label_aware(links: Links, index: int, area: SearchArea, model: SignalModel) -> LsreAnswer:
    """One LSRE–SOCP solve (73), projected onto the ray of link ``index`` unless the powers forbid it."""
    free = lsre_socp(links, area, model)
    projected = project_within_heights(links, index, free.position_enu_m, area)
    accepted = misfit(links, projected, model) <= misfit(links, free.position_enu_m, model) + _CHI2_TWO_99
    position = projected if accepted else free.position_enu_m
    power, exponent = refit_power_and_exponent(links, position, model)
    cost = rss_cost_db2(links, position, power, exponent, model)
    status = free.status if accepted or free.status != "ok" else "ok, projection refused by the powers"
    return LsreAnswer(position, power, exponent, cost, free.iterations, status)


def projection_label_aware_literal(
    links: Links, index: int, area: SearchArea, model: SignalModel
) -> LsreAnswer:
    """(73)–(76) as printed: J with the P̂_t and β̂ that (67)–(68) left, which makes the test vacuous.

    (66)–(69) are printed for every k: (68) then leaves J = 0 at the free solution whatever it
    is, and no other place can be as good. Were β_LOS kept on the LOS link through (68), J
    would be that one link's squared residual, and with (70) holding P̂_t back a residual of
    6 dB and more lets a few projections through (3 of 100; without (70) none): chance, not a
    test of the label.
    """
    free = lsre_socp_iterative(links, area, model, every_link=True)
    projected = project(links, index, free.position_enu_m)
    power, exponent = free.transmit_power_dbm, free.path_loss_exponent
    cost = rss_cost_db2(links, projected, power, exponent, model)
    if cost <= (1.0 + model.projection_tolerance) * free.rss_cost_db2:
        return LsreAnswer(projected, power, exponent, cost, free.iterations, free.status)
    return free
