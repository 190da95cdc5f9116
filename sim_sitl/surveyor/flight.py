"""Where the lone surveyor flies and what it hears there: the pilot, the poses, the samples.

Rule: the pilot decides by what was heard, as a person at the site would, never by where the
transmitter is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_sitl.randomness import Stream, generator
from sim_sitl.surveyor.radio import Radio
from sim_sitl.surveyor.survey import Survey

FloatArray = NDArray[np.float64]

POSE_HZ = 5


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
        times = now_s + np.arange(0.0, leg_s, 1.0 / POSE_HZ)
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
