"""A lone surveyor: one UAV with an uncalibrated receiver looks for a transmitter on open ground.

Exists because a real search by received power alone (one vehicle, 200–300 m, ten minutes) fails by
what the swarm's world leaves out: antennas that are deaf overhead, a ground that reflects, an
airframe that shades, a receiver that loses lock and whose decibels have no zero. Rules: nothing here
follows the station's model of the radio; one seed gives one flight; frames say what a vehicle's do.

The channel: two rays over ground (Fresnel coefficient of a vertical polarisation, weakened by
roughness), half-wave dipoles at both ends (the transmitter's tilted, the receiver's fixed to the
airframe), a random pattern of the airframe in body azimuth, shadowing with an exponential
correlation over the vehicle's place, Rician fading, outliers.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.geometry import Enu, Geodetic, LocalFrame
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.tlog import TlogWriter
from sim_sitl.modes import Flavour
from sim_sitl.randomness import Stream, generator
from sim_sitl.telemetry import Picture, build

FloatArray = NDArray[np.float64]

ORIGIN = Geodetic(47.3769, 8.5417, 420.0)
START_UNIX_USEC = 1_760_000_000_000_000
BEACON_ID = 0xA17
_LIGHT_M_S = 299_792_458.0
_POSE_HZ = 5
_WAVES = 240
_HEARTBEAT, _ATTITUDE, _POSITION, _HOME = 0, 30, 33, 242


@dataclass(frozen=True, slots=True)
class Survey:
    """What one flight is made of; ``draw`` gives a plausible one."""

    seed: int
    plan: str
    """``stops``: a coarse round of hovers, then a ring round the strongest; ``lanes``: a lawnmower."""
    half_width_m: float
    """Of the square search area round the origin, metres."""
    target_enu_m: Enu
    height_m: float
    """Of the vehicle above ground, metres."""
    frequency_hz: float
    unit_offset_db: float
    """What the receiver's decibels are off from dBm."""
    sample_hz: float
    shadowing_std_db: float
    shadowing_m: float
    """Distance over which shadowing forgets itself, metres."""
    rician_k_db: float
    transmitter_tilt_rad: float
    airframe_std_db: float
    """Size of the airframe's pattern, dB."""
    roughness_m: float
    """Standard deviation of the ground's height, metres."""
    ground_permittivity: float
    clutter_db_per_m: float
    """Loss on the way through what stands on the ground, per horizontal metre."""
    margin_db: float
    """Mean power above the threshold of lock at 100 m with both antennas at their best."""
    unlocked: str
    """Below lock the receiver gives ``noise`` (its floor, drifting) or ``nothing``."""
    turns: bool
    """The nose follows the flight; else it keeps one direction."""
    duration_s: float = 600.0


def draw(seed: int, plan: str = "stops") -> Survey:
    """A plausible flight; the same seed gives the same one."""
    rng = generator(seed, Stream.SURVEY, 0)
    half = float(rng.uniform(100.0, 150.0))
    # Most targets lie well inside, some near the edge, some a little outside.
    reach = half * float(rng.choice([0.5, 0.95, 1.1], p=[0.5, 0.4, 0.1]))
    place = rng.uniform(-reach, reach, 2)
    return Survey(
        seed,
        plan,
        half,
        (float(place[0]), float(place[1]), float(rng.uniform(0.5, 1.8))),
        float(rng.uniform(30.0, 60.0)),
        float(rng.choice([3.32e9, 0.9e9, 2.44e9])),
        float(rng.uniform(-60.0, 60.0)),
        float(rng.choice([1.0, 2.0, 5.0])),
        float(rng.uniform(3.0, 6.0)),
        float(rng.uniform(8.0, 30.0)),
        float(rng.uniform(3.0, 12.0)),
        math.radians(float(rng.uniform(0.0, 20.0))),
        float(rng.uniform(1.0, 3.0)),
        float(rng.uniform(0.01, 0.06)),
        float(rng.uniform(4.0, 20.0)),
        float(rng.uniform(0.0, 0.08)),
        float(rng.uniform(5.0, 40.0)),
        str(rng.choice(["noise", "nothing"])),
        bool(rng.integers(2)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """What was flown and heard; n samples of the receiver."""

    survey: Survey
    pose_s: FloatArray
    """(p,) times of the poses, seconds since the first."""
    position_enu_m: FloatArray
    """(p, 3) metres."""
    attitude_rad: FloatArray
    """(p, 3) roll, pitch, yaw."""
    velocity_enu_m_s: FloatArray
    """(p, 3)"""
    sample_s: FloatArray
    """(n,) times of the samples; seconds."""
    power_db: FloatArray
    """(n,) received power in the receiver's own decibels."""


class Radio:
    """The channel of one survey: power at any pose, the same at the same place."""

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        rng = generator(survey.seed, Stream.SURVEY, 1)
        tilt, toward = survey.transmitter_tilt_rad, rng.uniform(0.0, 2.0 * math.pi)
        self._transmitter_axis = np.array(
            [math.sin(tilt) * math.cos(toward), math.sin(tilt) * math.sin(toward), math.cos(tilt)]
        )
        # Frequencies of a field with exponential correlation: Student-t with one degree of freedom.
        waves = rng.normal(size=(_WAVES, 2)) / np.sqrt(rng.chisquare(1.0, size=(_WAVES, 1)))
        self._wave_rad_m = waves / survey.shadowing_m
        self._phase_rad = rng.uniform(0.0, 2.0 * math.pi, _WAVES)
        # So that the pattern's root mean square over the azimuth is that size on average.
        self._airframe = survey.airframe_std_db * rng.normal(size=(3, 2)) / math.sqrt(3.0)

    def mean_power_db(self, position_enu_m: FloatArray, attitude_rad: FloatArray) -> FloatArray:
        """(n,) without fading, dB over the threshold of lock; (n, 3) metres and (n, 3) radians."""
        survey = self._survey
        target = np.array(survey.target_enu_m)
        wave_m = _LIGHT_M_S / survey.frequency_hz
        axes = _body_axes(attitude_rad)
        field: Any = 0.0
        for image in (1.0, -1.0):
            source = target * np.array([1.0, 1.0, image])
            ray = position_enu_m - source
            distance = np.linalg.norm(ray, axis=1)
            ray = ray / distance[:, None]
            # The reflected ray leaves the antenna downwards.
            leaving = ray * np.array([1.0, 1.0, image])
            amplitude = _dipole(leaving @ self._transmitter_axis) * _dipole(
                np.einsum("ni,ni->n", ray, axes[:, 2])
            )
            if image < 0.0:
                amplitude = amplitude * self._reflection(ray[:, 2], wave_m)
            field = field + amplitude / distance * np.exp(-2j * math.pi * distance / wave_m)
        power = 20.0 * np.log10(np.maximum(np.abs(field), 1e-12)) + 40.0 + survey.margin_db
        way = position_enu_m - target
        power -= survey.clutter_db_per_m * np.hypot(way[:, 0], way[:, 1])
        result: FloatArray = power + self._airframe_db(way, axes) + self._shadowing_db(position_enu_m)
        return result

    def _reflection(self, sine: FloatArray, wave_m: float) -> FloatArray:
        """Fresnel's coefficient, weakened by the ground's roughness (Ament)."""
        relative = self._survey.ground_permittivity
        root = np.sqrt(relative - (1.0 - sine**2))
        smooth = (relative * sine - root) / (relative * sine + root)
        rough = np.exp(-2.0 * (2.0 * math.pi / wave_m * self._survey.roughness_m * sine) ** 2)
        result: FloatArray = smooth * rough
        return result

    def _airframe_db(self, from_target_m: FloatArray, axes: FloatArray) -> FloatArray:
        toward = -from_target_m / np.linalg.norm(from_target_m, axis=1)[:, None]
        forward = np.einsum("ni,ni->n", toward, axes[:, 0])
        right = np.einsum("ni,ni->n", toward, axes[:, 1])
        azimuth = np.arctan2(right, forward)
        order = np.arange(1, 4)[:, None]
        waves = self._airframe[:, :1] * np.cos(order * azimuth) + self._airframe[:, 1:] * np.sin(
            order * azimuth
        )
        result: FloatArray = waves.sum(axis=0) * np.hypot(forward, right)
        return result

    def _shadowing_db(self, position_enu_m: FloatArray) -> FloatArray:
        phase = position_enu_m[:, :2] @ self._wave_rad_m.T + self._phase_rad
        result: FloatArray = (
            self._survey.shadowing_std_db * math.sqrt(2.0 / _WAVES) * np.cos(phase).sum(axis=1)
        )
        return result

    def samples(
        self,
        position_enu_m: FloatArray,
        attitude_rad: FloatArray,
        interval_s: float,
        rng: np.random.Generator,
    ) -> tuple[FloatArray, Any]:
        """(n,) readings of consecutive samples in the receiver's decibels, and which were given."""
        survey = self._survey
        mean = self.mean_power_db(position_enu_m, attitude_rad)
        k = 10.0 ** (0.1 * survey.rician_k_db)
        moved = np.linalg.norm(np.diff(position_enu_m, axis=0, prepend=position_enu_m[:1]), axis=1)
        wave_m = _LIGHT_M_S / survey.frequency_hz
        # Hovering in the wind, the scattered part changes within half a second.
        keep = np.exp(-interval_s / 0.5 - moved / (0.4 * wave_m))
        drawn = (rng.normal(size=mean.size) + 1j * rng.normal(size=mean.size)) / math.sqrt(2.0)
        scattered = np.empty(mean.size, dtype=complex)
        state = drawn[0]
        for i, stays in enumerate(keep):
            state = stays * state + math.sqrt(max(1.0 - stays**2, 0.0)) * drawn[i]
            scattered[i] = state
        fading = np.abs(math.sqrt(k / (k + 1.0)) + scattered / math.sqrt(k + 1.0))
        level = mean + 20.0 * np.log10(np.maximum(fading, 1e-3))
        level += np.where(rng.random(mean.size) < 0.01, rng.normal(0.0, 15.0, mean.size), 0.0)
        locked = level + rng.normal(0.0, 1.0, mean.size) > 0.0
        drift = np.cumsum(rng.normal(0.0, 0.4 * math.sqrt(interval_s), mean.size))
        floor = -15.0 + 3.0 * np.tanh(drift / 3.0) + rng.normal(0.0, 2.5, mean.size)
        heard = locked | (survey.unlocked == "noise")
        return np.where(locked, level, floor) + survey.unit_offset_db, heard


def fly(survey: Survey) -> Flight:
    """The whole flight; deterministic."""
    radio = Radio(survey)
    rng = generator(survey.seed, Stream.SURVEY, 2)
    wind_rad = rng.uniform(-0.07, 0.07, 2)
    heading_rad = rng.uniform(-math.pi, math.pi)
    pilot = _Pilot(survey)
    interval_s = 1.0 / survey.sample_hz
    poses: list[tuple[FloatArray, FloatArray]] = []
    heard: list[tuple[FloatArray, FloatArray]] = []
    now_s = 0.0
    while now_s < survey.duration_s:
        leg_s, start, velocity, hovering = pilot.leg()
        leg_s = min(leg_s, survey.duration_s - now_s)
        times = now_s + np.arange(0.0, leg_s, 1.0 / _POSE_HZ)
        heading_rad = math.atan2(velocity[0], velocity[1]) if survey.turns and not hovering else heading_rad
        poses.append((times, _states(times - now_s, start, velocity, wind_rad, heading_rad, rng)))
        count = math.ceil(leg_s * survey.sample_hz)
        since: FloatArray = (np.arange(count, dtype=np.float64) + 0.5) * interval_s
        since = since[since < leg_s]
        if since.size:
            states = _states(since, start, velocity, wind_rad, heading_rad, rng)
            reading, given = radio.samples(states[:, :3], states[:, 3:6], interval_s, rng)
            heard.append((now_s + since[given], reading[given]))
            pilot.note(start, reading[given] if hovering else np.zeros(0))
        now_s += leg_s
    states = np.concatenate([state for _, state in poses])
    return Flight(
        survey,
        np.concatenate([times for times, _ in poses]),
        states[:, :3],
        states[:, 3:6],
        states[:, 6:9],
        np.concatenate([times for times, _ in heard]),
        np.concatenate([power for _, power in heard]),
    )


class _Pilot:
    """Decides the legs: (seconds, start, velocity, hovering)."""

    _SPEED_M_S = 6.0
    _HOVER_S = 6.0

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        edge = 0.85 * survey.half_width_m
        self._here = np.array([edge, -edge, survey.height_m])
        self._levels: list[tuple[float, FloatArray]] = []
        self._arrived = False
        self._ring = 0
        if survey.plan == "lanes":
            lanes = np.linspace(-edge, edge, 6)
            ends = [(x, (-edge, edge)[(i + side) % 2]) for i, x in enumerate(lanes[::-1]) for side in (0, 1)]
            self._coming = [np.array([x, y, survey.height_m]) for x, y in ends]
        else:
            steps = np.linspace(-edge, edge, 4)
            self._coming = [
                np.array([x, y, survey.height_m])
                for i, x in enumerate(steps[::-1])
                for y in (steps if i % 2 == 0 else steps[::-1])
            ]

    def note(self, place: FloatArray, readings: FloatArray) -> None:
        """What a hover heard."""
        if readings.size:
            self._levels.append((float(np.median(readings)), place.copy()))

    def leg(self) -> tuple[float, FloatArray, FloatArray, bool]:
        """The next one."""
        hovers = self._survey.plan != "lanes"
        if hovers and not self._arrived:
            self._arrived = True
            return self._HOVER_S, self._here, np.zeros(3), True
        if not self._coming:
            self._coming.append(self._ring_place() if hovers else -self._here * np.array([1.0, 1.0, -1.0]))
        there = self._coming.pop(0)
        leg = there - self._here
        length = float(np.linalg.norm(leg))
        start, self._here, self._arrived = self._here, there, False
        if length < 1e-6:
            return 1.0, start, np.zeros(3), False
        return length / self._SPEED_M_S, start, leg * (self._SPEED_M_S / length), False

    def _ring_place(self) -> FloatArray:
        """On a ring round the strongest place so far, kept within the area."""
        limit = self._survey.half_width_m
        strongest = max(self._levels, key=lambda kept: kept[0])[1] if self._levels else np.zeros(3)
        self._ring += 1
        angle, reach = 2.4 * self._ring, 20.0 + 40.0 * ((0.618 * self._ring) % 1.0)
        place = strongest[:2] + reach * np.array([math.cos(angle), math.sin(angle)])
        return np.array([*np.clip(place, -limit, limit), self._survey.height_m])


def _states(
    since_s: FloatArray,
    start: FloatArray,
    velocity: FloatArray,
    wind_rad: FloatArray,
    heading_rad: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, 9): place, roll, pitch, yaw, velocity along a leg; it leans into the wind and its way."""
    speed = float(np.linalg.norm(velocity))
    position = start + since_s[:, None] * velocity
    position = position + rng.normal(0.0, 0.1, position.shape)
    attitude = np.column_stack(
        [
            wind_rad[0] + rng.normal(0.0, 0.015, since_s.size),
            wind_rad[1] - 0.012 * speed + rng.normal(0.0, 0.015, since_s.size),
            heading_rad + rng.normal(0.0, 0.02, since_s.size),
        ]
    )
    return np.column_stack([position, attitude, np.broadcast_to(velocity, position.shape)])


def _body_axes(attitude_rad: FloatArray) -> FloatArray:
    """(n, 3, 3): forward, right and up of the airframe in ENU."""
    roll, pitch, yaw = attitude_rad.T
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    forward = np.stack([cp * sy, cp * cy, sp], axis=1)
    right = np.stack([sr * sp * sy + cr * cy, sr * sp * cy - cr * sy, -sr * cp], axis=1)
    return np.stack([forward, right, np.cross(right, forward)], axis=1)


def _dipole(cosine: FloatArray) -> FloatArray:
    """Amplitude of a half-wave dipole, ``cosine`` to its axis; 25 dB deep at most."""
    sine = np.sqrt(np.maximum(1.0 - np.square(cosine), 1e-9))
    result: FloatArray = np.maximum(np.abs(np.cos(0.5 * math.pi * cosine)) / sine, 10.0 ** (-25.0 / 20.0))
    return result


def write_tlog(flight: Flight, path: Path) -> None:
    """The recording of a flight: heartbeat, home, poses and SAR_RSS, as a vehicle sends them."""
    frame = LocalFrame(ORIGIN)
    encoder = Encoder(1, 1)
    records: list[tuple[float, int, Any]] = []
    for i, time_s in enumerate(flight.pose_s):
        picture = _picture(flight, i, frame)
        wanted = [_ATTITUDE, _POSITION]
        if i % _POSE_HZ == 0:
            wanted = [_HEARTBEAT, *wanted]
        if i % (10 * _POSE_HZ) == 0:
            wanted.append(_HOME)
        records += [(float(time_s), 0, build(message, picture)) for message in wanted]
    for n, (time_s, power_db) in enumerate(zip(flight.sample_s, flight.power_db, strict=True)):
        message = dialect.MAVLink_sar_rss_message(
            START_UNIX_USEC + round(float(time_s) * 1e6), BEACON_ID, round(flight.survey.frequency_hz),
            round(float(power_db) * 100.0), -32768, n & 0xFFFF,
        )  # fmt: skip
        records.append((float(time_s) + 0.05, 1, message))
    records.sort(key=lambda record: record[:2])
    with TlogWriter(path) as writer:
        for time_s, _, message in records:
            writer.write(START_UNIX_USEC + round(time_s * 1e6), encoder.pack(message))


def _picture(flight: Flight, i: int, frame: LocalFrame) -> Picture:
    roll, pitch, yaw = (float(value) for value in flight.attitude_rad[i])
    east, north, up = (float(value) for value in flight.position_enu_m[i])
    half = [0.5 * angle for angle in (roll, pitch, yaw)]
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, half), map(math.sin, half)
    return Picture(
        flavour=Flavour.ARDUPILOT,
        boot_ms=10_000 + round(float(flight.pose_s[i]) * 1e3),
        unix_usec=START_UNIX_USEC + round(float(flight.pose_s[i]) * 1e6),
        position=frame.to_geodetic((east, north, up)),
        height_above_home_m=up,
        velocity_enu_m_s=(
            float(flight.velocity_enu_m_s[i, 0]),
            float(flight.velocity_enu_m_s[i, 1]),
            float(flight.velocity_enu_m_s[i, 2]),
        ),
        roll_rad=roll,
        pitch_rad=pitch,
        yaw_rad=yaw,
        rates_rad_s=(0.0, 0.0, 0.0),
        attitude=(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        home=ORIGIN,
        target=None,
        custom_mode=4,
        armed=True,
        landed=False,
        booting=False,
        aligned=True,
        prearm_healthy=True,
        estimator_ready=True,
        guided=False,
        battery_percent=80.0,
    )


def area_geojson(survey: Survey) -> dict[str, Any]:
    """The search area as a GeoJSON Feature."""
    frame, half = LocalFrame(ORIGIN), survey.half_width_m
    corners = [(-half, -half), (half, -half), (half, half), (-half, half), (-half, -half)]
    places = [frame.to_geodetic((east, north, 0.0)) for east, north in corners]
    ring = [[round(place.longitude_deg, 8), round(place.latitude_deg, 8)] for place in places]
    return {
        "type": "Feature",
        "properties": {"name": "survey"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def write_area(survey: Survey, path: Path) -> None:
    """``area_geojson`` as a file."""
    path.write_text(json.dumps(area_geojson(survey)) + "\n", encoding="utf-8")
