"""``1aoa-nrss``: the paper's "1AOA-nRSS" (Section V-C), after its one sentence of description.

Exists as a baseline of the mixed environment, and the only method that uses angles of links
labelled NLOS. "Estimates an average bearing vector from the NLOS anchors and projects a LOS
ray from the LOS anchor" is read as: the line through the NLOS anchors' mean position along
the mean of their reported unit bearings, and the LOS ray's point nearest to that line, ρ ≥ 0.
Rule: nothing else bounds the answer. Two nearly parallel lines meet far away, so errors of
kilometres are the method's, not the code's; studies tell RMSE with and without errors above 500 m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.localization.batch import Answers, Batch
from groundstation.localization.rays import Rays, unit_bearings

_PARALLEL = 1e-12
_NOTHING = "the mean bearing of the NLOS links is parallel to the LOS ray, or none; other angles are needed"


def one_aoa_nrss(batch: Batch) -> Answers:
    """The LOS ray's point nearest to the mean bearing line of the NLOS anchors; no power is estimated."""
    rays, links = Rays.of(batch), batch.links
    used = links.has_angle() & ~batch.los()
    share = used / used.sum(axis=1, keepdims=True)
    bearings = unit_bearings(np.where(used, links.azimuth_rad, 0.0), np.where(used, links.elevation_rad, 0.0))
    mean_bearing = np.einsum("nk,nkc->nc", share, bearings)
    mean_place = np.einsum("nk,nkc->nc", share, batch.place)
    length = np.linalg.norm(mean_bearing, axis=1)
    line = mean_bearing / np.where(length > 0.0, length, np.nan)[:, None]
    # Nearest points of o + ρδ and p + τm: ρ from the normal equations of the two.
    cosine = np.einsum("ni,ni->n", rays.direction, line)
    offset = mean_place - rays.origin_enu_m
    on_ray = np.einsum("ni,ni->n", offset, rays.direction)
    on_line = np.einsum("ni,ni->n", offset, line)
    sine2 = 1.0 - cosine**2
    along = (on_ray - cosine * on_line) / np.where(sine2 > _PARALLEL, sine2, np.nan)
    position = rays.at(np.maximum(along, 0.0))
    unknown = np.full(batch.size, np.nan)
    answers = Answers.closed_form(batch, position, unknown, batch.first_exponents())
    status = [text if text == "ok" else _NOTHING for text in answers.status]
    return replace(answers, status=status)
