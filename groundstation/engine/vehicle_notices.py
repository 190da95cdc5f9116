"""What the operator is told of one vehicle's measurements, in words, and not over and over.

Rule: each fault is told when it begins and when it ends, with the number of samples it cost; what
flickers counts as going on.
"""

from __future__ import annotations

from typing import Any

from groundstation.domain.events import Event, Severity
from groundstation.domain.vehicle import AUTOPILOT_COMPONENT, SENSOR_COMPONENT
from groundstation.measurement.settings import MeasurementSettings
from groundstation.measurement.vehicle_clock import ClockStep, StepKind
from groundstation.measurement.vehicle_picture import VehiclePicture
from groundstation.measurement.vehicle_samples import VehicleSamples

_STRAYS_TOLD = 50
_CALM_NS = 5_000_000_000
_STEP_WORDS = {
    StepKind.REBOOT: "went back: it was restarted, or its clock was set",
    StepKind.FORWARD: "jumped ahead: its clock was set",
    StepKind.STALL: "stood still for a while",
}
_PLAIN = (
    "since_ns",
    "position_ns",
    "no_position_told",
    "dropped",
    "dropped_ns",
    "drop_told",
    "turn_told",
    "captures_ns",
)


class VehicleNotices:
    """Which notices of one vehicle are out. Times are station time, nanoseconds."""

    def __init__(self, settings: MeasurementSettings, vehicle_id: int, now_ns: int) -> None:
        self.vehicle_id = vehicle_id
        self._no_position_ns = round(settings.no_position_s * 1e9)
        self._settle_ns = round(settings.settle_s * 1e9)
        self._captures_every_ns = round(settings.cir_report_s * 1e9)
        self.captures_ns = now_ns
        self.dropped = 0
        self.dropped_ns = now_ns
        self.drop_told = False
        self.turn_told = False
        self.forget_stream(now_ns)

    def forget_stream(self, now_ns: int) -> None:
        """Begin to wait for positions and clocks anew."""
        self.since_ns = now_ns
        self.position_ns: int | None = None
        self.no_position_told = False
        self.strays_told: dict[int, None] = {}

    def position_came(self, now_ns: int) -> Event | None:
        """A valid position: the end of a notice, if one was out."""
        self.position_ns = now_ns
        if not self.no_position_told:
            return None
        self.no_position_told = False
        return self.event(now_ns, "vehicle.position", Severity.INFO, "{vehicle} has a position")

    def attitude_came(self) -> None:
        """A valid attitude: a later lack of them is news again."""
        self.turn_told = False

    def position(self, picture: VehiclePicture, now_ns: int) -> Event | None:
        """No position for too long."""
        if self.no_position_told or picture.lost:
            return None
        heard_ns = self.position_ns
        since_ns = self.since_ns if heard_ns is None else heard_ns
        if now_ns - since_ns < self._no_position_ns:
            return None
        self.no_position_told = True
        waited_s = (now_ns - since_ns) / 1e9
        what = "has sent no position for" if heard_ns is None else "stopped sending positions"
        ago = "" if heard_ns is None else " ago"
        text = f"{{vehicle}} {what} {waited_s:.0f} s{ago}: {picture.missing()}"
        return self.event(now_ns, "vehicle.no_position", Severity.WARNING, text)

    def drops(self, samples: VehicleSamples, picture: VehiclePicture, now_ns: int) -> Event | None:
        """Samples that no pose could place, and when they can be placed again."""
        if samples.unplaced:
            self.dropped += samples.unplaced
            self.dropped_ns = now_ns
            samples.unplaced = 0
            # A vehicle just found has not been asked for its pose yet: counted, no news.
            if self.drop_told or now_ns - self.since_ns < self._settle_ns:
                return None
            self.drop_told = True
            why = picture.missing() if self.position_ns is None else "no pose covers their time"
            text = f"{{vehicle}}: radio samples are dropped, they cannot be placed: {why}"
            return self.event(now_ns, "vehicle.samples_dropped", Severity.WARNING, text)
        if not self.drop_told or self.position_ns is None:
            return None
        if now_ns - self.dropped_ns < _CALM_NS or now_ns - self.position_ns >= _CALM_NS:
            return None
        text = f"{{vehicle}}: radio samples are placed again; {self.dropped} were dropped"
        self.drop_told = False
        self.dropped = 0
        return self.event(now_ns, "vehicle.samples_resumed", Severity.INFO, text)

    def turns(self, samples: VehicleSamples, now_ns: int) -> Event | None:
        """Airframe angles that no attitude could turn to earth."""
        if not samples.unturned:
            return None
        samples.unturned = 0
        if self.turn_told:
            return None
        self.turn_told = True
        text = (
            "{vehicle} sends no ATTITUDE: its sensor's angles are in the airframe's frame and are"
            " dropped, its levels are kept"
        )
        return self.event(now_ns, "vehicle.no_attitude", Severity.WARNING, text)

    def captures(self, samples: VehicleSamples, now_ns: int, *, final: bool = False) -> Event | None:
        """Incomplete impulse responses, summed up once in a while."""
        passed_ns = now_ns - self.captures_ns
        if passed_ns < self._captures_every_ns and not final:
            return None
        incomplete, complete = samples.cir_incomplete, samples.cir_complete
        samples.cir_incomplete = samples.cir_complete = 0
        self.captures_ns = now_ns
        if not incomplete:
            return None
        text = (
            f"{{vehicle}}: {incomplete} of {incomplete + complete} impulse responses came incomplete in"
            f" the last {passed_ns / 1e9:.0f} s and were given up"
        )
        return self.event(now_ns, "cir.incomplete", Severity.WARNING, text)

    def stepped(self, component_id: int, step: ClockStep, now_ns: int) -> Event:
        """A component's clock stepped."""
        self.strays_told.pop(component_id, None)
        text = (
            f"{{vehicle}}: the {_whose(component_id)}'s time {_STEP_WORDS[step.kind]}"
            f" ({-step.change_ns / 1e9:+.1f} s); mapped anew"
        )
        return self.event(now_ns, "clock.reset", Severity.WARNING, text)

    def strays(self, component_id: int, strays: int, now_ns: int) -> Event | None:
        """Too many of a component's times contradict its map."""
        if strays < _STRAYS_TOLD or component_id in self.strays_told:
            return None
        self.strays_told[component_id] = None
        text = (
            f"{{vehicle}}: the {_whose(component_id)}'s times contradict each other; either two vehicles"
            " use this system id, or a sender repeats old messages"
        )
        return self.event(now_ns, "clock.conflict", Severity.ERROR, text)

    def event(self, now_ns: int, code: str, severity: Severity, text: str) -> Event:
        """An event of this vehicle; a leading ``{vehicle}`` in ``text`` becomes its name."""
        text = text.replace("{vehicle}", f"vehicle {self.vehicle_id}", 1)
        return Event(now_ns, code, severity, text, vehicle_id=self.vehicle_id)

    def state(self) -> dict[str, Any]:
        """Everything, as a tree for a snapshot."""
        plain = {name: getattr(self, name) for name in _PLAIN}
        return {**plain, "strays_told": list(self.strays_told)}

    def restore(self, tree: dict[str, Any]) -> None:
        """Take back what ``state()`` gave."""
        for name in _PLAIN:
            setattr(self, name, tree[name])
        self.strays_told = dict.fromkeys(tree["strays_told"])


def _whose(component_id: int) -> str:
    if component_id == AUTOPILOT_COMPONENT:
        return "autopilot"
    return "radio sensor" if component_id == SENSOR_COMPONENT else f"component {component_id}"
