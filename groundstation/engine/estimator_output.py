"""Values at the estimator's edge: what it keeps of a window, what it says of a belief.

Exists to keep the engine to its flow. Rule: whatever leaves is rounded (1e-8°, mm, 1e-4 m²),
so that the last bit of a sum is not part of an answer.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pymap3d

from groundstation.domain.geometry import Geodetic, LocalFrame
from groundstation.domain.radio import LinkWindow
from groundstation.domain.target import Covariance, Environment, SearchMap, SnapshotEstimate, TargetState
from groundstation.localization.containment import Raster
from groundstation.localization.problem import FloatArray
from groundstation.tracking.search_map import square_shares


@dataclass(frozen=True, slots=True)
class Heard:
    """What is kept of a link window."""

    vehicle_id: int
    end_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    path_length_m: float
    rss_dbm: float | None
    rss_std_error_db: float | None
    azimuth_rad: float | None
    elevation_rad: float | None
    azimuth_std_rad: float | None
    elevation_std_rad: float | None
    los_probability: float
    classified: bool
    """Whether somebody judged the link; False: the probability is the prior."""
    position_std_m: float | None = None
    """How far off the vehicle's place may be, each horizontal axis; None: it did not say."""
    height_std_m: float | None = None

    @classmethod
    def of(
        cls, window: LinkWindow, los_probability: float, classified: bool, assumed_std_m: tuple[float, float]
    ) -> Heard:
        """The window and its verdict; ``assumed_std_m``: of an unsaid place, horizontal axis and height."""
        place, accuracy = window.position, window.place_accuracy
        return cls(
            window.vehicle_id, window.end_ns, place.latitude_deg, place.longitude_deg,
            place.altitude_amsl_m, window.path_length_m, window.rss_dbm, window.rss_std_error_db,
            window.azimuth_rad, window.elevation_rad, window.azimuth_std_error_rad,
            window.elevation_std_error_rad, los_probability, classified,
            *((None, None) if accuracy is None else accuracy.std_m(assumed_std_m)),
        )  # fmt: skip


def places_enu(heard: list[Heard], frame: LocalFrame) -> FloatArray:
    """(n, 3) metres ENU: where the vehicles were."""
    origin = frame.origin
    east, north, up = pymap3d.geodetic2enu(
        np.array([h.latitude_deg for h in heard]),
        np.array([h.longitude_deg for h in heard]),
        np.array([h.altitude_amsl_m for h in heard]),
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_amsl_m,
    )
    return np.stack([east, north, up], axis=1)


HEARD_FIELDS = tuple(entry.name for entry in fields(Heard))
"""In the order in which ``heard_row`` writes them."""


def heard_row(heard: Heard) -> list[Any]:
    """Plain values, for a state tree."""
    return [getattr(heard, name) for name in HEARD_FIELDS]


def rounded_place(place: Geodetic) -> Geodetic:
    """To 1e-8° (a millimetre) and a millimetre."""
    return Geodetic(
        round(place.latitude_deg, 8), round(place.longitude_deg, 8), round(place.altitude_amsl_m, 3)
    )


def covariance_tuple(covariance_m2: Any) -> Covariance:
    """Upper triangle, row-major, m²."""
    c = np.round(np.asarray(covariance_m2, dtype=np.float64), 4)
    return (
        float(c[0, 0]), float(c[0, 1]), float(c[0, 2]), float(c[1, 1]), float(c[1, 2]), float(c[2, 2])
    )  # fmt: skip


def regions_geodetic(regions: Any, frame: LocalFrame) -> tuple[Any, ...]:
    """Rings in east and north metres → (latitude, longitude) rings, at the origin's height."""
    origin = frame.origin
    result = []
    for share, rings in regions:
        turned = []
        for ring in rings:
            points = np.asarray(ring)
            latitude, longitude, _ = pymap3d.enu2geodetic(
                points[:, 0], points[:, 1], np.zeros(len(points)),
                origin.latitude_deg, origin.longitude_deg, origin.altitude_amsl_m,
            )  # fmt: skip
            turned.append(
                tuple(
                    (round(float(lat), 7), round(float(lon), 7))
                    for lat, lon in zip(latitude, longitude, strict=True)
                )
            )
        result.append((share, tuple(turned)))
    return tuple(result)


def search_map(state: TargetState, picture: Raster, frame: LocalFrame) -> SearchMap:
    """The raster of a belief with its georeference."""
    squares = square_shares(picture)
    rows, columns = squares.share.shape
    cell_m = round(picture.cell_m, 4)
    west_m, south_m = round(picture.west_m, 3), round(picture.south_m, 3)
    north_m, east_m = south_m + rows * cell_m, west_m + columns * cell_m
    corners = []
    for east, north in ((west_m, north_m), (east_m, north_m), (east_m, south_m), (west_m, south_m)):
        place = frame.to_geodetic((east, north, 0.0))
        corners.append((round(place.latitude_deg, 8), round(place.longitude_deg, 8)))
    return SearchMap(
        beacon_id=state.beacon_id,
        time_ns=state.time_ns,
        sequence=state.sequence,
        origin=frame.origin,
        west_m=west_m,
        north_m=round(north_m, 3),
        cell_m=cell_m,
        rows=int(rows),
        columns=int(columns),
        corners=tuple(corners),
        share=squares.share.astype("<f4").tobytes(),
        containment=squares.containment.astype("<u2").tobytes(),
    )


def snapshot_state(snapshot: SnapshotEstimate) -> dict[str, Any]:
    """Plain values, for a state tree."""
    place = snapshot.position
    return {
        "time_ns": snapshot.time_ns,
        "position": [place.latitude_deg, place.longitude_deg, place.altitude_amsl_m],
        "covariance_enu_m2": list(snapshot.covariance_enu_m2),
        "environment": int(snapshot.environment),
        "method": snapshot.method,
        "transmit_power_dbm": snapshot.transmit_power_dbm,
        "path_loss_exponent": list(snapshot.path_loss_exponent),
        "vehicle_ids": list(snapshot.vehicle_ids),
        "los_vehicle_ids": list(snapshot.los_vehicle_ids),
        "status": snapshot.status,
    }


def snapshot_from_state(tree: dict[str, Any]) -> SnapshotEstimate:
    """The reverse."""
    covariance = tuple(float(value) for value in tree["covariance_enu_m2"])
    power = tree["transmit_power_dbm"]
    return SnapshotEstimate(
        time_ns=int(tree["time_ns"]),
        position=Geodetic(*(float(value) for value in tree["position"])),
        covariance_enu_m2=(
            covariance[0], covariance[1], covariance[2], covariance[3], covariance[4], covariance[5]
        ),
        environment=Environment(int(tree["environment"])),
        method=str(tree["method"]),
        transmit_power_dbm=None if power is None else float(power),
        path_loss_exponent=tuple(float(value) for value in tree["path_loss_exponent"]),
        vehicle_ids=tuple(int(value) for value in tree["vehicle_ids"]),
        los_vehicle_ids=tuple(int(value) for value in tree["los_vehicle_ids"]),
        status=str(tree["status"]),
    )  # fmt: skip
