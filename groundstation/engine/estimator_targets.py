"""From a beacon's belief to what is told: state, snapshot, regions.

Exists to keep how a belief is worded apart from how it comes about. Rules: the snapshot
(Algorithm 1) is beside the belief and its failure costs the belief nothing; snapshots and
regions, which are dear, have intervals of their own.
"""

from __future__ import annotations

import math
from collections import Counter as Tally
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from groundstation.domain.geometry import LocalFrame
from groundstation.domain.target import Environment, SearchMap, SnapshotEstimate, TargetState
from groundstation.engine.estimator_beacon import Beacon
from groundstation.engine.estimator_output import (
    Heard,
    covariance_tuple,
    places_enu,
    regions_geodetic,
    rounded_place,
    search_map,
)
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.engine.estimator_verdicts import SOLVER_FAULTS
from groundstation.localization import Links, SearchArea, environment_of, locate
from groundstation.localization.containment import smooth_raster
from groundstation.localization.likelihood import shared_variance_m2
from groundstation.localization.problem import FloatArray, SignalModel
from groundstation.tracking import Tracker, TrackObservation, containment, region_rings

METHOD = "posterior-filter"


def observation(heard: Heard, place: FloatArray) -> TrackObservation:
    """What the tracker needs of a window; ``place`` (3,) metres ENU."""
    return TrackObservation(
        heard.vehicle_id, (float(place[0]), float(place[1]), float(place[2])),
        heard.rss_dbm, heard.rss_std_error_db,
        heard.azimuth_rad, heard.elevation_rad, heard.azimuth_std_rad, heard.elevation_std_rad,
        heard.los_probability, heard.classified, 1e-9 * heard.end_ns,
        heard.position_std_m, heard.height_std_m,
    )  # fmt: skip


def links_of(fresh: list[Heard], frame: LocalFrame) -> Links:
    """The newest windows as one snapshot."""

    def numbers(name: str) -> list[float]:
        return [np.nan if getattr(heard, name) is None else getattr(heard, name) for heard in fresh]

    return Links(
        places_enu(fresh, frame),
        np.array(numbers("rss_dbm")),
        np.array(numbers("azimuth_rad")),
        np.array(numbers("elevation_rad")),
        # A link that nobody judged counts as NLOS.
        np.array([heard.los_probability if heard.classified else 0.0 for heard in fresh]),
    )


def target_state(
    time_ns: int,
    beacon: Beacon,
    belief: Tracker,
    frame: LocalFrame,
    height_reference: str,
    settings: EstimatorSettings,
    tally: Tally[str],
    joined_beacon_ids: tuple[int, ...] = (),
    lively: Sequence[Beacon] = (),
) -> list[TargetState | SearchMap]:
    """The next state of a beacon; snapshot, regions and search map are made anew where due.

    ``lively``: beacons that are told of these days; of many, each has its turn less often.
    """
    mass = belief.mass
    model = settings.localization.model
    shift = belief.vehicle_variance_m2
    summary = containment(belief.mesh, mass, shift=shift)
    fresh = beacon.fresh(time_ns, settings.localization)
    environment, los_count = Environment.UNKNOWN, 0
    if fresh:
        links = links_of(fresh, frame)
        environment = environment_of(links, model)
        los_count = int(links.los(model.los_threshold).sum())
        _renew_snapshot(time_ns, beacon, fresh, links, belief.area, frame, settings, tally, lively)
    else:
        beacon.snapshot = None
    regions: tuple[Any, ...] = ()
    picture = None
    each_s, any_s = settings.regions_interval_s, settings.all_regions_interval_s
    if beacon.regions_ns is None or _is_due(beacon.regions_ns, time_ns, each_s, any_s, beacon, lively):
        beacon.regions_ns = time_ns
        picture = smooth_raster(belief.mesh, mass, shift=shift)
        regions = regions_geodetic(region_rings(belief.mesh, mass, picture=picture), frame)
    beacon.sequence += 1
    east, north, up = (float(value) for value in summary.position_enu_m)
    state = TargetState(
        beacon_id=beacon.beacon_id,
        time_ns=time_ns,
        first_heard_ns=beacon.first_heard_ns,
        last_heard_ns=beacon.last_heard_ns,
        position=rounded_place(frame.to_geodetic((east, north, up))),
        covariance_enu_m2=covariance_tuple(summary.covariance_m2),
        radius_90_m=round(summary.radius_90_m, 2),
        environment=environment,
        los_links=los_count,
        links=len(fresh),
        windows=beacon.windows,
        method=METHOD,
        height_reference=height_reference,
        sequence=beacon.sequence,
        snapshot=beacon.snapshot,
        regions=regions,
        walking_probability=round(belief.walking_probability, 3),
        joined_beacon_ids=joined_beacon_ids,
        vehicle_position_std_m=math.sqrt(shift[0]),
    )
    return [state] if picture is None else [state, search_map(state, picture, frame)]


def _model_of(fresh: list[Heard], links: Links, model: SignalModel) -> SignalModel:
    """The model with the vehicles' places as good as these windows' vehicles say."""
    if all(heard.position_std_m is None for heard in fresh):
        return model
    assumed = model.vehicle_std_m
    told = [
        [
            mine if std is None else std
            for std, mine in zip((h.position_std_m, h.height_std_m), assumed, strict=True)
        ]
        for h in fresh
    ]
    counts = np.where(np.isfinite(links.azimuth_rad), links.los_probability, 0.0)
    flat, upright = shared_variance_m2(np.square(told), counts, model)
    return replace(model, vehicle_position_std_m=math.sqrt(flat), vehicle_height_std_m=math.sqrt(upright))


def _is_due(
    last_ns: int, time_ns: int, each_s: float, any_s: float, beacon: Beacon, lively: Sequence[Beacon]
) -> bool:
    """Whether what a beacon had at ``last_ns`` is due again: every ``each_s``, or one by one in turn.

    With so many that each would get one more often than ``any_s`` apart in all, every beacon has a
    moment of its own in a round: the load of many is bounded and even.
    """
    round_ns = int(len(lively) * any_s * 1e9)
    if time_ns - last_ns < int(each_s * 1e9):
        return False
    if round_ns <= int(each_s * 1e9):
        return True
    place = next((number for number, other in enumerate(lively) if other is beacon), 0)
    mine_ns = place * round_ns // len(lively)
    return (time_ns - mine_ns) // round_ns > (last_ns - mine_ns) // round_ns


def _renew_snapshot(
    time_ns: int,
    beacon: Beacon,
    fresh: list[Heard],
    links: Links,
    area: SearchArea,
    frame: LocalFrame,
    settings: EstimatorSettings,
    tally: Tally[str],
    lively: Sequence[Beacon],
) -> None:
    """Algorithm 1 on the newest windows, when it is due and has enough of them."""
    limits = settings.localization
    if len(fresh) < limits.model.minimum_links:
        tally["snapshots_too_few_links"] += 1
        beacon.snapshot = None
        return
    each_s, any_s = settings.snapshot_interval_s, settings.snapshots_interval_s
    last_ns = beacon.snapshot_ns
    if last_ns is None and len(lively) * any_s > each_s:
        # Many new beacons at once wait for their turns, too.
        last_ns = beacon.first_heard_ns
    if last_ns is not None and not _is_due(last_ns, time_ns, each_s, any_s, beacon, lively):
        return
    beacon.snapshot_ns = time_ns
    model = _model_of(fresh, links, limits.model)
    try:
        estimate = locate(links, area, "adaptive", model, limits.choice)
    except SOLVER_FAULTS:
        # The belief does not need the snapshot; all vehicles in one place is a normal sight.
        tally["snapshot_failures"] += 1
        beacon.snapshot = None
        return
    tally["snapshots"] += 1
    east, north, up = (float(value) for value in estimate.position_enu_m)
    los = links.los(limits.model.los_threshold)
    power = estimate.transmit_power_dbm
    beacon.snapshot = SnapshotEstimate(
        time_ns=time_ns,
        position=rounded_place(frame.to_geodetic((east, north, up))),
        # What the vehicles' told places are off by in common moves the answer with them.
        covariance_enu_m2=covariance_tuple(estimate.covariance_m2 + model.vehicle_covariance_m2),
        environment=estimate.environment,
        method=estimate.method,
        transmit_power_dbm=round(power, 3) if np.isfinite(power) else None,
        path_loss_exponent=tuple(round(float(value), 4) for value in estimate.path_loss_exponent),
        vehicle_ids=tuple(heard.vehicle_id for heard in fresh),
        los_vehicle_ids=tuple(h.vehicle_id for h, is_los in zip(fresh, los, strict=True) if is_los),
        status=estimate.status,
    )
