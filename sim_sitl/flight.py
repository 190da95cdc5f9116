"""How a multirotor moves: limited speed and acceleration, tilt that follows from both.

Keeps the rule that attitude is consistent with motion, since body-frame angles are rotated
by it. ENU metres; attitude as MAVLink has it (roll, pitch, yaw of forward–right–down against
north–east–down). No MAVLink in here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from groundstation.domain.geometry import Enu, Quaternion, wrap_angle_rad

GRAVITY_M_S2 = 9.80665
HORIZONTAL_ACCELERATION_M_S2 = 2.5
VERTICAL_ACCELERATION_M_S2 = 2.0
CLIMB_SPEED_M_S = 2.5
DESCENT_SPEED_M_S = 1.5
POSITION_GAIN_PER_S = 1.0
VELOCITY_TIME_CONSTANT_S = 0.3
TILT_TIME_CONSTANT_S = 0.2
DRAG_PER_S = 0.15
"""Acceleration that air takes per speed: why a multirotor leans forward in level flight."""
YAW_RATE_RAD_S = math.radians(60)
GUST_SIGMA_M_S = 0.12
GUST_TIME_S = 2.0
TURN_SPEED_M_S = 1.0
"""Slower than this a vehicle keeps its heading."""


@dataclass(frozen=True, slots=True)
class Stay:
    """Come to rest and stay there."""


@dataclass(frozen=True, slots=True)
class GoTo:
    """Fly straight to a place and stop there."""

    target_enu_m: Enu
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Orbit:
    """Fly round a centre, counter-clockwise seen from above."""

    center_m: tuple[float, float]
    radius_m: float
    height_m: float
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Descend:
    """Straight down at landing speed."""


@dataclass(frozen=True, slots=True)
class Grounded:
    """On the ground, motors off or idle."""


Goal = Stay | GoTo | Orbit | Descend | Grounded


class Flight:
    """One vehicle's motion. ``step`` advances it by a fixed slice of time."""

    def __init__(self, position_enu_m: Enu, yaw_rad: float, rng: np.random.Generator) -> None:
        self.position_m = list(position_enu_m)
        self.velocity_m_s = [0.0, 0.0, 0.0]
        self.roll_rad = 0.0
        self.pitch_rad = 0.0
        self.yaw_rad = yaw_rad
        self.rates_rad_s = (0.0, 0.0, 0.0)
        self.goal: Goal = Grounded()
        self._gust = [0.0, 0.0, 0.0]
        self._rng = rng
        self._stay_at: Enu | None = None

    @property
    def position_enu_m(self) -> Enu:
        """Where it is."""
        return self.position_m[0], self.position_m[1], self.position_m[2]

    @property
    def velocity_enu_m_s(self) -> Enu:
        """How fast, gusts included."""
        v, g = self.velocity_m_s, self._gust
        return v[0] + g[0], v[1] + g[1], v[2] + g[2]

    @property
    def attitude(self) -> Quaternion:
        """Body to north–east–down."""
        return quaternion_from_euler(self.roll_rad, self.pitch_rad, self.yaw_rad)

    def set_goal(self, goal: Goal) -> None:
        """A new goal, at once."""
        if goal != self.goal:
            self._stay_at = None
        self.goal = goal

    def carrot_enu_m(self) -> Enu | None:
        """The place being flown to, as an autopilot reports its target; None where there is none."""
        goal = self.goal
        if isinstance(goal, GoTo):
            return goal.target_enu_m
        if isinstance(goal, Stay):
            return self._stay_at or self.position_enu_m
        if isinstance(goal, Orbit):
            angle = math.atan2(self.position_m[1] - goal.center_m[1], self.position_m[0] - goal.center_m[0])
            angle += goal.speed_m_s / goal.radius_m
            return (
                goal.center_m[0] + goal.radius_m * math.cos(angle),
                goal.center_m[1] + goal.radius_m * math.sin(angle),
                goal.height_m,
            )
        return None

    def step(self, dt_s: float) -> None:
        """Advance by ``dt_s`` (0.02 s or so)."""
        if isinstance(self.goal, Grounded):
            self.velocity_m_s = [0.0, 0.0, 0.0]
            self._gust = [0.0, 0.0, 0.0]
            self.roll_rad = self.pitch_rad = 0.0
            self.rates_rad_s = (0.0, 0.0, 0.0)
            return
        wanted = self._wanted_velocity()
        acceleration = [
            (w - v) / VELOCITY_TIME_CONSTANT_S for w, v in zip(wanted, self.velocity_m_s, strict=True)
        ]
        horizontal = math.hypot(acceleration[0], acceleration[1])
        if horizontal > HORIZONTAL_ACCELERATION_M_S2:
            acceleration[0] *= HORIZONTAL_ACCELERATION_M_S2 / horizontal
            acceleration[1] *= HORIZONTAL_ACCELERATION_M_S2 / horizontal
        acceleration[2] = max(-VERTICAL_ACCELERATION_M_S2, min(VERTICAL_ACCELERATION_M_S2, acceleration[2]))
        keep = math.exp(-dt_s / GUST_TIME_S)
        kick = GUST_SIGMA_M_S * math.sqrt(1 - keep * keep) * self._rng.standard_normal(3)
        for i in range(3):
            self.velocity_m_s[i] += acceleration[i] * dt_s
            self._gust[i] = keep * self._gust[i] + float(kick[i])
            self.position_m[i] += (self.velocity_m_s[i] + self._gust[i]) * dt_s
        self._turn(acceleration, dt_s)

    def _wanted_velocity(self) -> list[float]:
        goal = self.goal
        if isinstance(goal, GoTo):
            return self._towards(goal.target_enu_m, goal.speed_m_s)
        if isinstance(goal, Orbit):
            east = self.position_m[0] - goal.center_m[0]
            north = self.position_m[1] - goal.center_m[1]
            radius = max(math.hypot(east, north), 1e-3)
            inward = max(-goal.speed_m_s, min(goal.speed_m_s, POSITION_GAIN_PER_S * (radius - goal.radius_m)))
            # What the velocity loop's lag would otherwise let drift outwards.
            inward += VELOCITY_TIME_CONSTANT_S * goal.speed_m_s**2 / goal.radius_m
            east, north = east / radius, north / radius
            return [
                -goal.speed_m_s * north - inward * east,
                goal.speed_m_s * east - inward * north,
                self._climb(goal.height_m),
            ]
        if isinstance(goal, Descend):
            slow = self.position_m[2] < 5.0
            return [0.0, 0.0, -0.5 if slow else -DESCENT_SPEED_M_S]
        if self._stay_at is None:
            # Stop first, then stay where it stopped.
            if math.hypot(*self.velocity_m_s) > 0.3:
                return [0.0, 0.0, 0.0]
            self._stay_at = self.position_enu_m
        return self._towards(self._stay_at, 3.0)

    def _towards(self, target_enu_m: Enu, speed_m_s: float) -> list[float]:
        east, north = target_enu_m[0] - self.position_m[0], target_enu_m[1] - self.position_m[1]
        distance = math.hypot(east, north)
        speed = min(
            speed_m_s,
            POSITION_GAIN_PER_S * distance,
            math.sqrt(2 * 0.7 * HORIZONTAL_ACCELERATION_M_S2 * distance),
        )
        scale = speed / distance if distance > 1e-6 else 0.0
        return [east * scale, north * scale, self._climb(target_enu_m[2])]

    def _climb(self, height_m: float) -> float:
        wanted = POSITION_GAIN_PER_S * (height_m - self.position_m[2])
        return max(-DESCENT_SPEED_M_S, min(CLIMB_SPEED_M_S, wanted))

    def _turn(self, acceleration: list[float], dt_s: float) -> None:
        before = (self.roll_rad, self.pitch_rad, self.yaw_rad)
        velocity = self.velocity_m_s
        if math.hypot(velocity[0], velocity[1]) > TURN_SPEED_M_S:
            error = wrap_angle_rad(math.atan2(velocity[0], velocity[1]) - self.yaw_rad)
            limit = YAW_RATE_RAD_S * dt_s
            self.yaw_rad = wrap_angle_rad(self.yaw_rad + max(-limit, min(limit, error * min(1.0, 2 * dt_s))))
        push_east = acceleration[0] + DRAG_PER_S * velocity[0] - 0.5 * self._gust[0]
        push_north = acceleration[1] + DRAG_PER_S * velocity[1] - 0.5 * self._gust[1]
        forward = push_east * math.sin(self.yaw_rad) + push_north * math.cos(self.yaw_rad)
        right = push_east * math.cos(self.yaw_rad) - push_north * math.sin(self.yaw_rad)
        share = min(1.0, dt_s / TILT_TIME_CONSTANT_S)
        self.pitch_rad += share * (-math.atan2(forward, GRAVITY_M_S2) - self.pitch_rad)
        self.roll_rad += share * (math.atan2(right, math.hypot(GRAVITY_M_S2, forward)) - self.roll_rad)
        self.rates_rad_s = (
            (self.roll_rad - before[0]) / dt_s,
            (self.pitch_rad - before[1]) / dt_s,
            wrap_angle_rad(self.yaw_rad - before[2]) / dt_s,
        )


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """(w, x, y, z) of the rotation body → NED for yaw, pitch, roll in this order."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def rotate_to_body(attitude: Quaternion, vector_ned: Enu) -> Enu:
    """A north–east–down vector in the airframe (forward, right, down)."""
    w, x, y, z = attitude
    n, e, d = vector_ned
    return (
        (1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d,
        2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d,
        2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d,
    )
