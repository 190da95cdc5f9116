"""Every case of the studies, by name: one geometry, one channel, one kind of link states and labels.

Exists so that tables, figures and tests speak of the same cases. Rule: a case is a value that
can be pickled; its trials come from the generator it is given and from nothing else, so that
the same seed gives the same trials in any process.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from groundstation.localization import Links
from groundstation.localization.problem import BoolArray, FloatArray
from sim_sitl.studies.channels import (
    TRANSMIT_POWER_DBM,
    AnalyticChannel,
    AngleReport,
    Channel,
    RubbleChannel,
    told_model,
)
from sim_sitl.studies.end_to_end import DatasetChannel, draw_rows, label_odds
from sim_sitl.studies.geometry import HARD_GEOMETRIES, DatasetRows, Geometry, Ring, area_of, draw_targets
from sim_sitl.studies.laws import law_of
from sim_sitl.studies.limits import CANDIDATES, Knowledge, StatePrior, crlb_square_m2, posterior_square_m2
from sim_sitl.studies.trials import Trials

ENVIRONMENTS = ("LOS", "NLOS", "mixed", "end to end", "hard")


@dataclass(frozen=True, slots=True)
class LinkStates:
    """How many of a trial's links are line of sight."""

    shares: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Shares of trials with all links LOS, none, and exactly one (any of them alike)."""

    def draw(self, count: int, links: int, rng: np.random.Generator) -> BoolArray:
        """(N, K) true: line of sight."""
        kind = rng.choice(3, size=count, p=self.shares)
        alone = rng.integers(links, size=count)
        single = np.arange(links) == alone[:, None]
        states: BoolArray = np.where((kind == 2)[:, None], single, (kind == 0)[:, None])
        return states

    def prior(self, links: int) -> StatePrior:
        """The combinations of K link states that occur, and how often."""
        every, none, one = self.shares
        combinations = np.concatenate([np.ones((1, links)), np.zeros((1, links)), np.eye(links)]) > 0.5
        weight = np.array([every, none, *[one / links] * links])
        return StatePrior(combinations[weight > 0.0], weight[weight > 0.0])


LOS = LinkStates((1.0, 0.0, 0.0))
NLOS = LinkStates((0.0, 1.0, 0.0))
MIXED = LinkStates((0.0, 0.0, 1.0))
END_TO_END = LinkStates((0.15, 0.25, 0.60))


@dataclass(frozen=True, slots=True)
class Case:
    """One case: everything a worker needs to draw its trials."""

    name: str
    """Key in ``CASES``."""
    title: str
    """What it is, one line."""
    environment: str
    """One of ``ENVIRONMENTS``."""
    states: LinkStates
    """Which links are line of sight."""
    geometry: Geometry = field(default_factory=Ring)
    """Where vehicles and target are."""
    channel: Channel = field(default_factory=AnalyticChannel)
    """Received power."""
    angles: AngleReport = field(default_factory=AngleReport)
    """What the arrays report."""
    classified: bool = False
    """Whether P(line of sight) is the shipped classifier's; else the true label, 1 or 0."""

    @property
    def vehicles(self) -> int:
        """K."""
        return self.geometry.vehicles

    @property
    def radius_m(self) -> float:
        """Radius of the search area, metres."""
        return self.geometry.radius_m

    @property
    def limit_name(self) -> str:
        """What ``limit_square_m2`` gives."""
        if self.states == LOS:
            return "CRLB"
        if isinstance(self.geometry, DatasetRows):
            return "exact posterior mean, vehicles' places no evidence"
        return "exact posterior mean"

    def draw(self, count: int, rng: np.random.Generator) -> Trials:
        """``count`` trials, all randomness from ``rng``."""
        target = draw_targets(count, self.radius_m, rng)
        power = rng.uniform(*TRANSMIT_POWER_DBM, count)
        bias_max = rng.uniform(*self.channel.bias_max_db, count)
        line_of_sight = self.states.draw(count, self.vehicles, rng)
        probability = line_of_sight.astype(np.float64)
        rows = None
        if self.classified:
            rows = draw_rows(line_of_sight, rng)
            probability = rows.los_probability
        if rows is not None and isinstance(self.geometry, DatasetRows):
            vehicles = target[:, None, :] + rows.offset_m
        else:
            vehicles = self.geometry.place(target, rng)
        offset = vehicles - target[:, None, :]
        if rows is not None and isinstance(self.channel, DatasetChannel):
            loss = self.channel.loss_of(rows, offset, line_of_sight)
        else:
            loss = self.channel.loss_db(offset, line_of_sight, rng)
        azimuth, elevation = self.angles.draw(offset, line_of_sight, rng)
        return Trials(
            Links(vehicles, power[:, None] - loss, azimuth, elevation, probability), target,
            area_of(self.geometry), told_model(self.channel, self.angles), power, bias_max, line_of_sight,
        )  # fmt: skip

    def limit_square_m2(self, trials: Trials, rng: np.random.Generator) -> FloatArray:
        """(N,) squared error of the limit on each trial, m² (of the CRLB: its trace)."""
        if self.states == LOS:
            return crlb_square_m2(trials)
        # Bearings that may be false need candidates along each of them.
        candidates = 2 * CANDIDATES if self.classified else CANDIDATES
        return posterior_square_m2(trials, self.knowledge(), rng, candidates)

    def knowledge(self, *, places: bool = False) -> Knowledge:
        """What the exact posterior of this case knows.

        ``places``: where vehicles are drawn round the target, take where they are as evidence.
        """
        known = Knowledge(law_of(self.channel), self.angles)
        if self.classified:
            known = replace(known, states=self.states.prior(self.vehicles), odds=label_odds)
        if places and isinstance(self.geometry, DatasetRows):
            known = replace(known, places=self.geometry.density)
        return known


RADII_M = (100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0)
"""R₀ of the paper's second scenario (K = 4)."""
VEHICLES = (4, 5, 6, 7)
"""K of its first (R₀ = 100 m)."""
ROUNDED = AngleReport(std_deg=0.0, rounded_deg=1.0)
"""V-D: LOS angles rounded to a degree (σ = 0.29°), NLOS angles uniform."""


def _rings(name: str, what: str, environment: str, states: LinkStates, **others: Any) -> list[Case]:
    """The paper's two scenarios of one environment: over K, and over R₀."""
    rings = [(f"k{count}", Ring(count)) for count in VEHICLES]
    rings += [(f"r{radius:g}", Ring(radius_m=radius)) for radius in RADII_M]
    return [
        Case(
            f"{name}-{key}", f"{what}, K = {ring.vehicles}, R₀ = {ring.radius_m:g} m", environment,
            states, ring, **others,
        )
        for key, ring in rings
    ]  # fmt: skip


def _analytic() -> list[Case]:
    per_link = AnalyticChannel(exponent_per_link=True)
    return [
        *_rings("los", "LOS, σ_θ = σ_φ = 1°", "LOS", LOS),
        *_rings("los-3deg", "LOS, σ_θ = σ_φ = 3°", "LOS", LOS, angles=AngleReport(3.0)),
        *_rings("nlos", "NLOS, eq. (8)", "NLOS", NLOS),
        *_rings(
            "nlos-rubble", "NLOS, Friis and eq. (11), values ours", "NLOS", NLOS, channel=RubbleChannel()
        ),
        Case("nlos-per-link-k4", "NLOS, eq. (8), β of each link its own", "NLOS", NLOS, channel=per_link),
        *_rings("mixed", "mixed, NLOS links by eq. (8)", "mixed", MIXED),
    ]


def _end_to_end() -> list[Case]:
    kind, shares = "end to end", "15/25/60 %, labels by the classifier"
    rows, ring = DatasetRows(), Ring()
    zero = replace(ROUNDED, nlos_zero=True)
    made: list[tuple[str, str, Geometry, Channel, AngleReport]] = [
        ("analytic", "V-C geometry, power by eqs. (7), (8)", ring, AnalyticChannel(), ROUNDED),
        ("rows", "four rows of the data set, its power", rows, DatasetChannel(), ROUNDED),
        ("ring", "V-C geometry, the data set's power", ring, DatasetChannel(), ROUNDED),
        ("rows-zero", "four rows of the data set, NLOS angles zero", rows, DatasetChannel(), zero),
    ]
    return [
        Case(
            f"end-to-end-{name}", f"{shares}: {what}", kind, END_TO_END, geometry, channel, angles,
            classified=True,
        )
        for name, what, geometry, channel, angles in made
    ]  # fmt: skip


def _hard() -> list[Case]:
    return [
        Case(f"hard-{name}-{label.lower()}", f"{label}: {what}", "hard", states, geometry)
        for name, (what, geometry) in HARD_GEOMETRIES.items()
        for states, label in ((LOS, "LOS"), (MIXED, "mixed"), (NLOS, "NLOS"))
    ]


CASES: dict[str, Case] = {case.name: case for case in (*_analytic(), *_end_to_end(), *_hard())}
"""By name. ``…-k4`` and ``…-r100`` are the same case under two names, one for each figure."""
