"""A small MAVLink autopilot: boots, arms, takes off, flies where it is told, and answers as one.

Imitates what a live ArduCopter 4.6 was seen to do (silent but for heartbeats until asked for
streams, refusals and all) or PX4's modes. Keeps the sim's rule: no clock and no socket here;
``step`` and ``receive`` are given the time. What it does with commands is in commands.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from groundstation.domain.geometry import Enu, Geodetic, LocalFrame
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from sim_sitl.flight import Descend, Flight, Goal, GoTo, Grounded, Stay
from sim_sitl.modes import Behaviour, Flavour, mode_number, modes_of
from sim_sitl.randomness import Stream, generator
from sim_sitl.telemetry import Picture, build

TICK_S = 0.02
"""Motion is integrated on this raster, counted from the start of the run."""
POSITION_NOISE_M = 0.25
"""Standard deviation of the estimator's position error, a slow random walk, each axis."""
POSITION_NOISE_TIME_S = 45.0
GPS_TIME_LAG_S = 0.3
"""SYSTEM_TIME of the recorded vehicles was this far behind."""
AUTO_DISARM_S = 10.0
TIMESYNC_INTERVAL_S = 10.0
MAX_OUTBOX = 4096
PX4_STREAMS_S = {
    1: 1.0, 2: 1.0, 24: 0.2, 30: 0.05, 31: 0.1, 33: 0.2, 74: 0.25, 87: 0.5,
    147: 1.0, 230: 1.0, 242: 2.0, 245: 0.2,
}  # fmt: skip
"""What PX4 sends unasked: message id → interval."""


@dataclass(frozen=True, slots=True)
class VehicleSettings:
    """How one vehicle starts."""

    system_id: int
    home_enu_m: Enu
    """Where it stands or stood at boot."""
    flavour: Flavour = Flavour.ARDUPILOT
    airborne: bool = True
    """Starts in the air, armed, its pattern under way."""
    start_enu_m: Enu = (0.0, 0.0, 50.0)
    """Where it starts when airborne."""
    pattern: Goal | None = None
    """Flown until first commanded, when airborne."""
    speed_m_s: float = 8.0
    position_after_s: float = 9.0
    """From boot to the first position."""
    prearm_after_s: float = 23.0
    """From boot to healthy pre-arm checks."""
    ready_after_s: float = 42.0
    """From boot to an estimator that uses GPS."""
    start_unix_usec: int = 1_800_000_000_000_000
    """Unix time at the run's start."""


class Vehicle:
    """One autopilot with its airframe. ``boot_time_s`` is on the run's time."""

    def __init__(self, settings: VehicleSettings, frame: LocalFrame, seed: int) -> None:
        self.settings = settings
        self.system_id = settings.system_id
        self.flavour = settings.flavour
        self._frame = frame
        rng = generator(seed, Stream.AUTOPILOT, settings.system_id)
        self._rng = rng
        airborne = settings.airborne
        self.boot_time_s = -(120.0 + 3.0 * float(rng.random())) if airborne else 0.0
        self._clock_skew = 5e-6 * float(rng.standard_normal())
        start = settings.start_enu_m if airborne else settings.home_enu_m
        middle = math.atan2(start[1], start[0])
        self.flight = Flight(
            start, math.remainder(-middle, 2 * math.pi), generator(seed, Stream.WIND, settings.system_id)
        )
        self.time_s = 0.0
        self.armed = airborne
        self.landed = not airborne
        self.armed_at_s = 0.0
        self.speed_m_s = settings.speed_m_s
        self.home: Geodetic | None = frame.to_geodetic(settings.home_enu_m) if airborne else None
        self.paused: Goal | None = None
        self.custom_mode = self._first_mode(airborne)
        if airborne:
            self.flight.set_goal(settings.pattern or Stay())
        self._encoder = Encoder(settings.system_id, AUTOPILOT_COMPONENT)
        self._outbox: list[bytes] = []
        self.outbox_dropped = 0
        self._intervals_s: dict[int, float] = {0: 1.0}
        if self.flavour is Flavour.PX4:
            self._intervals_s |= PX4_STREAMS_S
        phase = float(rng.random())
        self._due_s: dict[int, float] = dict.fromkeys(self._intervals_s, phase)
        self._timesync_due_s = 9.0 + phase
        self._error_m = [POSITION_NOISE_M * float(x) for x in rng.standard_normal(3)]
        self._boot_texts = [] if airborne else [
            (0.9, "Barometer 1 calibration complete"),
            (1.4, "ArduPilot Ready" if self.flavour is Flavour.ARDUPILOT else "PX4 ready"),
            (3.4, "AHRS: EKF3 active"),
            (4.8, "EKF3 IMU0 tilt alignment complete"),
            (settings.ready_after_s, "EKF3 IMU0 is using GPS"),
        ]  # fmt: skip

    # ── what it is ────────────────────────────────────────────────────────────────────────────

    @property
    def since_boot_s(self) -> float:
        """Age of the autopilot by its own clock."""
        return (self.time_s - self.boot_time_s) * (1.0 + self._clock_skew)

    @property
    def has_position(self) -> bool:
        """Whether GLOBAL_POSITION_INT is anything but zeros."""
        return self.since_boot_s >= self.settings.position_after_s

    @property
    def ready(self) -> bool:
        """Whether it would arm."""
        age = self.since_boot_s
        return age >= self.settings.ready_after_s and age >= self.settings.prearm_after_s

    @property
    def behaviour(self) -> Behaviour:
        """Of the flight mode it is in."""
        return modes_of(self.flavour)[self.custom_mode][1]

    @property
    def mode(self) -> str:
        """The flight mode's name."""
        return modes_of(self.flavour)[self.custom_mode][0]

    def estimated_enu_m(self) -> Enu:
        """Where it believes to be."""
        x, y, z = self.flight.position_enu_m
        return x + self._error_m[0], y + self._error_m[1], z + (0.0 if self.landed else self._error_m[2])

    def to_enu(self, place: Geodetic) -> Enu:
        """A place in the run's frame."""
        return self._frame.to_enu(place)

    # ── time ──────────────────────────────────────────────────────────────────────────────────

    def step(self, time_s: float) -> None:
        """Advance by one tick, to ``time_s``."""
        self.time_s = time_s
        self.flight.step(TICK_S)
        keep = math.exp(-TICK_S / POSITION_NOISE_TIME_S)
        kick = POSITION_NOISE_M * math.sqrt(1 - keep * keep)
        for i, draw in enumerate(self._rng.standard_normal(3)):
            self._error_m[i] = keep * self._error_m[i] + kick * float(draw)
        self._run_state()
        while self._boot_texts and self.since_boot_s >= self._boot_texts[0][0]:
            self.say(6, self._boot_texts.pop(0)[1])
        if self.home is None and self.since_boot_s >= self.settings.position_after_s + 10.0:
            self._set_home()
        picture: Picture | None = None
        for message_id, due_s in self._due_s.items():
            if time_s >= due_s:
                interval = self._intervals_s[message_id]
                # Late by less than a tick: keep the raster; else begin a new one.
                self._due_s[message_id] = due_s + interval if time_s - due_s < interval else time_s + interval
                picture = picture or self.picture()
                message = build(message_id, picture)
                if message is not None:
                    self.send(message)
        if time_s >= self._timesync_due_s:
            self._timesync_due_s += TIMESYNC_INTERVAL_S
            self.send(dialect.MAVLink_timesync_message(0, self.boot_ns()))

    def take(self) -> list[bytes]:
        """Frames to send since the last call."""
        frames, self._outbox = self._outbox, []
        return frames

    def _run_state(self) -> None:
        up = self.flight.position_m[2] - self.settings.home_enu_m[2]
        goal = self.flight.goal
        if self.armed and self.landed:
            if up > 0.3:
                self.landed = False
            elif isinstance(goal, Grounded) and self.time_s - self.armed_at_s > AUTO_DISARM_S:
                self.disarm()
        elif self.armed and isinstance(goal, Descend) and up <= 0.05:
            self.flight.position_m[2] = self.settings.home_enu_m[2]
            self.flight.set_goal(Grounded())
            self.landed = True
            self.disarm()
        elif self.behaviour is Behaviour.RETURN and isinstance(goal, GoTo):
            home = self.settings.home_enu_m
            if math.hypot(self.flight.position_m[0] - home[0], self.flight.position_m[1] - home[1]) < 1.0:
                self.flight.set_goal(Descend())
        if self.behaviour is Behaviour.TAKEOFF and isinstance(goal, GoTo) and up > goal.target_enu_m[2] - 0.5:
            self.custom_mode = mode_number(self.flavour, "AUTO.LOITER")
        if self.armed and not self.landed and up < 0.0:
            self.flight.position_m[2] = self.settings.home_enu_m[2]

    # ── what others make it do (commands.py) ──────────────────────────────────────────────────

    def arm(self) -> None:
        """Motors on."""
        self.armed = True
        self.armed_at_s = self.time_s
        self._set_home()
        self.say(6, "Arming motors")

    def disarm(self) -> None:
        """Motors off."""
        self.armed = False
        if not self.landed:
            # Only by force: it falls; the ground is where it ends.
            self.flight.position_m[2] = self.settings.home_enu_m[2]
            self.landed = True
        self.flight.set_goal(Grounded())
        self.say(6, "Disarming motors")

    def enter_mode(self, custom_mode: int) -> bool:
        """Change mode; False where the vehicle refuses it."""
        known = modes_of(self.flavour).get(custom_mode)
        if known is None:
            return False
        name, behaviour = known
        if behaviour is not Behaviour.MANUAL and not self.has_position:
            self.say(4, f"Mode change to {name} failed: requires position")
            return False
        if behaviour is Behaviour.AUTO and (self.landed or self.settings.pattern is None):
            self.say(4, f"Mode change to {name} failed: init failed")
            return False
        same = custom_mode == self.custom_mode
        self.custom_mode = custom_mode
        self.paused = None
        if self.landed or same:
            return True
        if behaviour is Behaviour.RETURN:
            home = self.settings.home_enu_m
            height = max(self.flight.position_m[2], home[2] + 15.0)
            self.flight.set_goal(GoTo((home[0], home[1], height), self.speed_m_s))
        elif behaviour is Behaviour.LAND:
            self.flight.set_goal(Descend())
        elif behaviour is Behaviour.AUTO and self.settings.pattern is not None:
            self.flight.set_goal(self.settings.pattern)
        else:
            self.flight.set_goal(Stay())
        return True

    def fly_to(self, target_enu_m: Enu) -> None:
        """A new place to fly to; ignored on the ground."""
        self.paused = None
        if not self.landed:
            self.flight.set_goal(GoTo(target_enu_m, self.speed_m_s))

    def take_off(self, height_above_home_m: float) -> None:
        """Straight up."""
        east, north, _ = self.flight.position_enu_m
        height = self.settings.home_enu_m[2] + height_above_home_m
        self.flight.set_goal(GoTo((east, north, height), self.speed_m_s))

    def set_interval(self, message_id: int, interval_us: float) -> None:
        """SET_MESSAGE_INTERVAL: −1 off, 0 the default, else µs."""
        if interval_us < 0:
            self._intervals_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
            return
        default = 1.0 if message_id == 0 else PX4_STREAMS_S.get(message_id, 1.0)
        self._intervals_s[message_id] = max(interval_us * 1e-6, TICK_S) if interval_us > 0 else default
        self._due_s[message_id] = self.time_s + TICK_S

    def interval_us(self, message_id: int) -> int:
        """What GET_MESSAGE_INTERVAL answers: −1 off."""
        return round(self._intervals_s[message_id] * 1e6) if message_id in self._intervals_s else -1

    # ── speaking ──────────────────────────────────────────────────────────────────────────────

    def send(self, message: Any) -> None:
        """Put a message into the outbox (bounded; what does not fit is counted)."""
        if len(self._outbox) >= MAX_OUTBOX:
            self.outbox_dropped += 1
            return
        self._outbox.append(self._encoder.pack(message))

    def say(self, severity: int, text: str) -> None:
        """STATUSTEXT."""
        self.send(dialect.MAVLink_statustext_message(severity, text.encode()[:50]))

    def boot_ns(self) -> int:
        """The autopilot's clock."""
        return round(self.since_boot_s * 1e9)

    def picture(self) -> Picture:
        """Everything telemetry may say now."""
        position = self._frame.to_geodetic(self.estimated_enu_m()) if self.has_position else None
        guided = self.behaviour in (Behaviour.GUIDED, Behaviour.TAKEOFF) and not self.landed
        carrot = self.flight.carrot_enu_m() if guided else None
        usec = self.settings.start_unix_usec + round((self.time_s - GPS_TIME_LAG_S) * 1e6)
        flight = self.flight
        return Picture(
            flavour=self.flavour,
            boot_ms=int(self.since_boot_s * 1000),
            unix_usec=usec if self.has_position else None,
            position=position,
            height_above_home_m=self.estimated_enu_m()[2] - self.settings.home_enu_m[2],
            velocity_enu_m_s=flight.velocity_enu_m_s,
            roll_rad=flight.roll_rad,
            pitch_rad=flight.pitch_rad,
            yaw_rad=flight.yaw_rad,
            rates_rad_s=flight.rates_rad_s,
            attitude=flight.attitude,
            home=self.home,
            target=self._frame.to_geodetic(carrot) if carrot else None,
            custom_mode=self.custom_mode,
            armed=self.armed,
            landed=self.landed,
            booting=self.since_boot_s < 2.0,
            aligned=self.since_boot_s >= 5.0,
            prearm_healthy=self.since_boot_s >= self.settings.prearm_after_s,
            estimator_ready=self.since_boot_s >= self.settings.ready_after_s,
            guided=guided,
            battery_percent=max(0.0, 100.0 - max(0.0, self.time_s) / 15.0),
        )

    def _set_home(self) -> None:
        self.home = self._frame.to_geodetic(self.settings.home_enu_m)
        for message_id in (49, 242):
            self.send(build(message_id, self.picture()))

    def _first_mode(self, airborne: bool) -> int:
        if not airborne:
            return mode_number(
                self.flavour, "STABILIZE" if self.flavour is Flavour.ARDUPILOT else "AUTO.LOITER"
            )
        if self.flavour is Flavour.ARDUPILOT:
            return mode_number(self.flavour, "GUIDED")
        # Not AUTO.MISSION: a station rightly takes nobody out of somebody's mission.
        return mode_number(self.flavour, "AUTO.LOITER")
