"""Everything that ingest keeps of one vehicle, and what it makes of each of its messages.

Why apart from ingest.py, vehicle_notices.py and vehicle_listening.py: those decide whose frame it is,
which words the operator reads and what counts as having listened, this one what a message means.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from groundstation.domain.events import Event, Severity
from groundstation.domain.radio import LinkActivity, LinkWindow, Listener, Listening
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT, SENSOR_COMPONENT, VehicleState
from groundstation.engine.vehicle_listening import VehicleListening
from groundstation.engine.vehicle_notices import VehicleNotices
from groundstation.mavlink import messages as m
from groundstation.mavlink.vehicle_message import VehicleMessage
from groundstation.measurement.pose_history import PoseHistory
from groundstation.measurement.sequence import FrameLoss
from groundstation.measurement.settings import MeasurementSettings
from groundstation.measurement.status_text import StatusTexts
from groundstation.measurement.tally import Tally
from groundstation.measurement.vehicle_clock import ClockStep, OffsetMap, SenderClock
from groundstation.measurement.vehicle_picture import VehiclePicture
from groundstation.measurement.vehicle_samples import VehicleSamples

IngestOutput = LinkWindow | Listening | LinkActivity | VehicleState | VehicleMessage | Event
"""What ingest says: to the estimator, to the page, to the command desk, to the operator."""

_COMPONENTS_MAX = 16
_PLAIN = ("_silent_since_ns", "_dirty", "_state_ns")


class VehicleIntake:
    """One vehicle: its clocks, poses, samples and picture. Times are station time, nanoseconds."""

    def __init__(self, settings: MeasurementSettings, vehicle_id: int, tally: Tally, found_ns: int) -> None:
        self.vehicle_id = vehicle_id
        self._settings = settings
        self._tally = tally
        self._label = f"vehicle={vehicle_id}"
        self.picture = VehiclePicture(vehicle_id)
        self.clocks: dict[int, SenderClock] = {AUTOPILOT_COMPONENT: SenderClock(settings)}
        self.poses = PoseHistory(settings)
        self.samples = VehicleSamples(
            settings, vehicle_id, self.poses, self.clocks[AUTOPILOT_COMPONENT].boot, tally
        )
        self.loss = FrameLoss()
        self.texts = StatusTexts()
        self._silent_since_ns = found_ns
        self.notices = VehicleNotices(settings, vehicle_id, found_ns)
        self._dirty = False
        self._state_ns: int | None = None
        self._listening = VehicleListening(settings, vehicle_id)
        self._lost_ns = round(settings.vehicle_lost_s * 1e9)
        self._interval_ns = round(settings.state_interval_s * 1e9)

    def message(
        self, component_id: int, connection: str, message: m.Message, now_ns: int, out: list[IngestOutput]
    ) -> None:
        """One typed message of one of the vehicle's components."""
        self.picture.connections[connection] = now_ns
        if component_id == SENSOR_COMPONENT:
            self.picture.sensor_heard_ns = now_ns
        kind = type(message)
        take = _TAKES.get(kind)
        if take is not None:
            self._sample(component_id, message, now_ns, out, take)
            return
        if kind in _FOR_THE_DESK:
            out.append(VehicleMessage(self.vehicle_id, component_id, connection, now_ns, message))
        if kind in _ANY_COMPONENT or component_id == AUTOPILOT_COMPONENT:
            handler = _HANDLERS.get(kind)
            if handler is not None:
                handler(self, component_id, message, now_ns, out)
                if self._dirty and (self._state_ns is None or now_ns - self._state_ns >= self._interval_ns):
                    out.append(self._state_now(now_ns))

    def tick(self, now_ns: int, out: list[IngestOutput]) -> None:
        """Let time pass."""
        closed: list[LinkWindow] = []
        activities: list[LinkActivity] = []
        self.samples.tick(now_ns, closed, activities)
        self._give(closed, out)
        out += activities
        picture = self.picture
        if not picture.lost and now_ns - max(picture.heartbeat_ns, self._silent_since_ns) >= self._lost_ns:
            picture.lost = True
            silent_s = (now_ns - picture.heartbeat_ns) / 1e9
            text = f"{{vehicle}} is lost: no heartbeat for {silent_s:.0f} s"
            out.append(self.notices.event(now_ns, "vehicle.lost", Severity.ERROR, text))
            out.append(self._state_now(now_ns))
        notices = self.notices
        told = (
            notices.position(picture, now_ns),
            notices.drops(self.samples, picture, now_ns),
            notices.turns(self.samples, now_ns),
            notices.captures(self.samples, now_ns),
        )
        out += [event for event in told if event is not None]
        for severity, sentence in self.texts.tick(now_ns):
            out.append(notices.event(now_ns, "vehicle.text", severity, f"{{vehicle}}: {sentence}"))
        if self._dirty and (self._state_ns is None or now_ns - self._state_ns >= self._interval_ns):
            out.append(self._state_now(now_ns))

    def listened(self, start_ns: int, end_ns: int) -> Listener | None:
        """What was heard, and where, in an interval that ends now; None: not known to have listened."""
        offset_ns = self.clocks[AUTOPILOT_COMPONENT].boot.offset_ns
        return self._listening.take(start_ns, end_ns, self.picture.sensor_heard_ns, offset_ns, self.poses)

    def end(self, now_ns: int, out: list[IngestOutput]) -> None:
        """Nothing more will come: close all windows, tell what was not told yet."""
        closed: list[LinkWindow] = []
        self.samples.end(closed)
        self._give(closed, out)
        told = self.notices.captures(self.samples, now_ns, final=True)
        if told is not None:
            out.append(told)
        if self._dirty:
            out.append(self._state_now(now_ns))

    def forget_stream(self, now_ns: int) -> None:
        """The station was away: clocks, poses and all that is under way is worthless now."""
        self.samples.forget_stream()
        self.poses = PoseHistory(self._settings)
        self.clocks = {AUTOPILOT_COMPONENT: SenderClock(self._settings)}
        self.samples.follow(self.poses, self.clocks[AUTOPILOT_COMPONENT].boot)
        self.loss = FrameLoss()
        self.notices.forget_stream(now_ns)
        self._silent_since_ns = now_ns
        self._listening.forget_stream()

    # --- messages of the autopilot

    def _heartbeat(
        self, component_id: int, message: m.Heartbeat, now_ns: int, out: list[IngestOutput]
    ) -> None:
        if component_id != AUTOPILOT_COMPONENT:
            return
        picture = self.picture
        before = picture.urgent
        picture.heartbeat(message, now_ns)
        if picture.lost:
            picture.lost = False
            text = "{vehicle} is heard again"
            out.append(self.notices.event(now_ns, "vehicle.recovered", Severity.INFO, text))
        self._changed(before, now_ns, out)

    def _sys_status(self, _: int, message: m.SysStatus, now_ns: int, out: list[IngestOutput]) -> None:
        before = self.picture.urgent
        self.picture.sys_status(message)
        self._changed(before, now_ns, out)

    def _ekf_status(self, _: int, message: m.EkfStatus, now_ns: int, out: list[IngestOutput]) -> None:
        before = self.picture.urgent
        self.picture.ekf_status(message)
        self._changed(before, now_ns, out)

    def _gps_raw(self, _: int, message: m.GpsRaw, now_ns: int, out: list[IngestOutput]) -> None:
        self.picture.gps_raw(message)
        self._dirty = True

    def _home_position(self, _: int, message: m.HomePosition, now_ns: int, out: list[IngestOutput]) -> None:
        self.picture.home_position(message)
        self._dirty = True

    def _position_target(
        self, _: int, message: m.PositionTarget, now_ns: int, out: list[IngestOutput]
    ) -> None:
        self.picture.position_target(message)
        self._dirty = True

    def _attitude(self, component_id: int, message: m.Attitude, now_ns: int, out: list[IngestOutput]) -> None:
        boot_ns = self._pose_time(message.boot_ms, now_ns, out)
        if boot_ns is None:
            return
        if not self.poses.add_attitude(boot_ns, message.attitude):
            self._tally.add("pose_duplicate_total", self._label)
            return
        self.picture.attitude = message.attitude
        self._dirty = True
        self.notices.attitude_came()
        self._place(out)

    def _global_position(
        self, _: int, message: m.GlobalPosition, now_ns: int, out: list[IngestOutput]
    ) -> None:
        boot_ns = self._pose_time(message.boot_ms, now_ns, out)
        if boot_ns is None:
            return
        position = message.position
        if position is None or not position.is_valid():
            self._tally.add("position_invalid_total", self._label)
            return
        if not self.poses.add_position(
            boot_ns, position.latitude_deg, position.longitude_deg, position.altitude_amsl_m
        ):
            self._tally.add("pose_duplicate_total", self._label)
            return
        offset_ns = self.clocks[AUTOPILOT_COMPONENT].boot.offset_ns
        assert offset_ns is not None
        self.picture.global_position(message, boot_ns + offset_ns)
        self._dirty = True
        told = self.notices.position_came(now_ns)
        if told is not None:
            out.append(told)
        self._place(out)

    def _pose_time(self, boot_ms: int, now_ns: int, out: list[IngestOutput]) -> int | None:
        clock = self.clocks[AUTOPILOT_COMPONENT]
        station_ns = clock.observe_boot_ms(boot_ms, now_ns)
        scale = clock.boot
        if scale.step is not None:
            self._stepped(AUTOPILOT_COMPONENT, scale, now_ns, out)
        if station_ns is None or scale.offset_ns is None:
            self._tally.add("pose_clock_unsettled_total", self._label)
            told = self.notices.strays(AUTOPILOT_COMPONENT, scale.strays, now_ns)
            if told is not None:
                out.append(told)
            return None
        return station_ns - scale.offset_ns

    def _place(self, out: list[IngestOutput]) -> None:
        closed: list[LinkWindow] = []
        self.samples.place_covered(closed)
        self._give(closed, out)

    def _give(self, closed: list[LinkWindow], out: list[IngestOutput]) -> None:
        accuracy = self.picture.place_accuracy
        out += closed if accuracy is None else [replace(w, place_accuracy=accuracy) for w in closed]

    # --- messages of any component

    def _system_time(
        self, component_id: int, message: m.SystemTime, now_ns: int, out: list[IngestOutput]
    ) -> None:
        clock = self._clock(component_id)
        if clock is None:
            return
        clock.observe_boot_ms(message.boot_ms, now_ns)
        if clock.boot.step is not None:
            self._stepped(component_id, clock.boot, now_ns, out)
        if message.unix_usec is not None:
            clock.observe_usec(message.unix_usec, now_ns)
            scale = clock.map_of_usec(message.unix_usec)
            if scale.step is not None:
                if component_id == AUTOPILOT_COMPONENT:
                    # Nothing of the autopilot's is stamped in Unix time: its first fix is no news.
                    scale.step = None
                else:
                    self._stepped(component_id, scale, now_ns, out)

    def _timesync(self, component_id: int, message: m.Timesync, now_ns: int, out: list[IngestOutput]) -> None:
        clock = self._clock(component_id)
        if clock is None or message.tc1 <= 0:
            return
        scale = clock.map_of_usec(message.tc1 // 1000)
        if not scale.timesync(message.tc1, message.ts1, now_ns):
            # Answers to other ground stations come this way too.
            self._tally.add("timesync_refused_total", self._label)

    def _status_text(
        self, component_id: int, message: m.StatusText, now_ns: int, out: list[IngestOutput]
    ) -> None:
        found = self.texts.add(component_id, message, now_ns)
        if found is not None:
            severity, sentence = found
            out.append(self.notices.event(now_ns, "vehicle.text", severity, f"{{vehicle}}: {sentence}"))

    def _sample(
        self,
        component_id: int,
        message: Any,
        now_ns: int,
        out: list[IngestOutput],
        take: Callable[[VehicleSamples, Any, int, int], LinkActivity | None],
    ) -> None:
        self.picture.sensor_heard_ns = now_ns
        self._listening.heard(message.beacon_id, message)
        clock = self.clocks.get(component_id) or self._clock(component_id)
        if clock is None:
            return
        time_usec = message.time_usec
        scale = clock.map_of_usec(time_usec)
        station_ns = scale.observe(time_usec * 1000, now_ns)
        if scale.step is not None:
            self._stepped(component_id, scale, now_ns, out)
        if station_ns is None:
            self._tally.add("sample_clock_unsettled_total", self._label)
            told = self.notices.strays(component_id, scale.strays, now_ns)
            if told is not None:
                out.append(told)
            return
        activity = take(self.samples, message, station_ns, now_ns)
        if activity is not None:
            out.append(activity)

    def _clock(self, component_id: int) -> SenderClock | None:
        clock = self.clocks.get(component_id)
        if clock is None:
            if len(self.clocks) >= _COMPONENTS_MAX:
                self._tally.add("component_overflow_total", self._label)
                return None
            clock = self.clocks[component_id] = SenderClock(self._settings)
        return clock

    def _stepped(self, component_id: int, scale: OffsetMap, now_ns: int, out: list[IngestOutput]) -> None:
        step: ClockStep | None = scale.step
        assert step is not None
        scale.step = None
        self._tally.add("clock_reset_total", f"kind={step.kind.value}")
        if component_id == AUTOPILOT_COMPONENT:
            self.poses.clear()
        else:
            self.samples.sensor_restarted()
        out.append(self.notices.stepped(component_id, step, now_ns))

    def _changed(self, before: tuple[str, bool, bool, bool], now_ns: int, out: list[IngestOutput]) -> None:
        if self.picture.urgent != before:
            out.append(self._state_now(now_ns))
        else:
            self._dirty = True

    def _state_now(self, now_ns: int) -> VehicleState:
        self._dirty = False
        self._state_ns = now_ns
        scale = self.clocks[AUTOPILOT_COMPONENT].boot
        uncertainty_ns = None if scale.offset_ns is None else scale.uncertainty_ns()
        return self.picture.snapshot(now_ns, self.loss.percent(), uncertainty_ns)

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        return {
            **{name.lstrip("_"): getattr(self, name) for name in _PLAIN},
            "notices": self.notices.state(),
            "picture": self.picture.state(),
            "clocks": [[component, clock.state()] for component, clock in self.clocks.items()],
            "poses": self.poses.state(),
            "samples": self.samples.state(),
            "loss": self.loss.state(),
            "texts": self.texts.state(),
            "packets": self._listening.state(),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        for name in _PLAIN:
            setattr(self, name, tree[name.lstrip("_")])
        self.notices.restore(tree["notices"])
        self.picture.restore(tree["picture"])
        self.clocks = {}
        for component, kept in tree["clocks"]:
            self.clocks[component] = SenderClock(self._settings)
            self.clocks[component].restore(kept)
        self.poses.restore(tree["poses"])
        self.samples.follow(self.poses, self.clocks[AUTOPILOT_COMPONENT].boot)
        self.samples.restore(tree["samples"])
        self.loss.restore(tree["loss"])
        self.texts.restore(tree["texts"])
        # Kept before listening was told: none.
        self._listening.restore(tree.get("packets", []))


_Handler = Callable[[VehicleIntake, int, Any, int, list[IngestOutput]], None]
_Take = Callable[[VehicleSamples, Any, int, int], LinkActivity | None]
_TAKES: dict[type, _Take] = {
    m.RssSample: VehicleSamples.rss,
    m.AoaSample: VehicleSamples.aoa,
    m.CirFragment: VehicleSamples.cir,
    m.LinkStateReport: VehicleSamples.link_state,
}
_HANDLERS: dict[type, _Handler] = {
    m.Heartbeat: VehicleIntake._heartbeat,
    m.SysStatus: VehicleIntake._sys_status,
    m.SystemTime: VehicleIntake._system_time,
    m.GpsRaw: VehicleIntake._gps_raw,
    m.Attitude: VehicleIntake._attitude,
    m.GlobalPosition: VehicleIntake._global_position,
    m.PositionTarget: VehicleIntake._position_target,
    m.Timesync: VehicleIntake._timesync,
    m.EkfStatus: VehicleIntake._ekf_status,
    m.HomePosition: VehicleIntake._home_position,
    m.StatusText: VehicleIntake._status_text,
}
_ANY_COMPONENT: frozenset[type] = frozenset({m.Heartbeat, m.SystemTime, m.Timesync, m.StatusText})
_FOR_THE_DESK: frozenset[type] = frozenset(
    {
        m.Heartbeat,
        m.CommandAck,
        m.PositionTarget,
        m.HomePosition,
        m.StatusText,
        m.Timesync,
        m.ExtendedSysState,
        m.EkfStatus,
        m.SysStatus,
    }
)
