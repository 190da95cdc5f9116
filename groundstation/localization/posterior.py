"""``posterior``: the snapshot's posterior mean, everything unknown marginalised.

Exists because in NLOS no point criterion beats the posterior mean, and because LOS, mixed
and NLOS are one model once the labels are soft. Rule: its likelihood is the tracker's; this
is the tracker's first update, one observation a link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.localization.likelihood import (
    Evidence,
    ExponentGrid,
    Observations,
    angle_log_likelihood,
    whiten,
)
from groundstation.localization.mesh import Mesh, MeshSettings, masses, moments, refine
from groundstation.localization.problem import FloatArray, Links, SearchArea, SignalModel

_SNAPSHOT_MESH = MeshSettings(base_cells=16, maximum_cells=1600, split_mass=0.008)
_CORRELATION_M = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorAnswer:
    """The belief of one snapshot."""

    position_enu_m: FloatArray
    """(3,) posterior mean, metres."""
    covariance_m2: FloatArray
    """(3, 3) m²."""
    transmit_power_dbm: float
    """Posterior mean at the most likely place."""
    path_loss_exponent: FloatArray
    """(K,) β_LOS or the posterior mean of β_NLOS, by the links' probabilities."""
    mesh: Mesh
    """Where it was evaluated."""
    mass: FloatArray
    """(C,) belief in each box."""


def snapshot_observations(links: Links, model: SignalModel) -> Observations:
    """The links as observations of K different vehicles."""
    count = links.count
    los_probability = np.nan_to_num(links.los_probability, nan=0.0)
    return Observations(
        links.position_enu_m,
        np.arange(count),
        links.rss_dbm,
        los_probability,
        np.zeros(count),
        links.azimuth_rad,
        links.elevation_rad,
        np.tile([model.azimuth_std_rad, model.elevation_std_rad], (count, 1)),
        los_probability,
        np.ones(count),
        np.full((count, 1), -1),
    )


def posterior(links: Links, area: SearchArea, model: SignalModel) -> PosteriorAnswer:
    """Posterior over position given one snapshot of K ≥ 1 links; prior uniform over the area."""
    observations = snapshot_observations(links, model)
    rows = whiten(observations, 0, links.count, _CORRELATION_M, model)
    exponents = ExponentGrid.of(model)

    def evidence_at(mesh: Mesh) -> Evidence:
        evidence = Evidence.empty(mesh.count, links.count)
        evidence.add(observations, rows, mesh.center_enu_m)
        evidence.angle_log += angle_log_likelihood(observations, 0, mesh.center_enu_m, mesh.half_m, model)
        return evidence

    mesh, log_likelihood, _ = refine(area, lambda m: evidence_at(m).log_likelihood(exponents), _SNAPSHOT_MESH)
    mass = masses(log_likelihood, mesh)
    mean, covariance = moments(mesh, mass)
    best = int(np.argmax(log_likelihood))
    at_best = evidence_at(mesh.keep(np.arange(mesh.count) == best))
    _, los, nlos = at_best.exponents_at(0, exponents)
    nuisance = at_best.nuisances_at(0, los, nlos)
    p = observations.los_probability
    return PosteriorAnswer(
        mean,
        covariance,
        model.transmit_power_mean_dbm + model.transmit_power_std_db * float(nuisance[0]),
        p * los + (1.0 - p) * nlos,
        mesh,
        mass,
    )
