"""Messages to frames, and the few messages that the station itself sends.

One Encoder speaks for one (system, component) and owns its sequence counter: two counters for
one identity would look like losses to everyone who listens.
"""

from __future__ import annotations

from struct import Struct
from typing import Any

from fastcrc import crc16

from groundstation.domain.errors import InternalError, PeerError
from groundstation.domain.geometry import Geodetic
from groundstation.domain.target import TargetState
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.framing import MAGIC_V2, SIGNATURE_LENGTH, SIGNED_FLAG, frame_of

STATION_SYSTEM = 255
STATION_COMPONENT = 190
"""MAV_COMP_ID_MISSIONPLANNER, what ground stations use."""

_HEADER_V2 = Struct("<BBBBBBBHB").pack
_CRC = Struct("<H").pack


def payload_of(message: Any) -> bytes:
    """The payload of a dialect message, trailing zeros included.

    Raises InternalError where a field does not fit its type.
    """
    # The generated pack() of each class knows its fields' order and hands the payload to _pack.
    message._pack = _payload_only
    try:
        payload: bytes = message.pack(None)
    except Exception as error:
        raise InternalError(f"cannot encode {message.get_type()}: {error}") from error
    finally:
        del message._pack
    return payload


def _payload_only(_link: None, _crc_extra: int, payload: bytes, force_mavlink1: bool = False) -> bytes:
    return payload


class Encoder:
    """Frames of one sender."""

    def __init__(self, system_id: int = STATION_SYSTEM, component_id: int = STATION_COMPONENT) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self.sequence = 0
        """Of the next frame."""

    def next_sequence(self) -> int:
        """Takes a sequence number, for a frame that is not packed here (see ``rewrite``)."""
        sequence = self.sequence
        self.sequence = (sequence + 1) & 0xFF
        return sequence

    def pack(self, message: Any) -> bytes:
        """The frame (MAVLink 2, unsigned) of a dialect message.

        Raises InternalError where a field does not fit its type.
        """
        return self.pack_payload(message.get_msgId(), payload_of(message))

    def pack_payload(self, message_id: int, payload: bytes) -> bytes:
        """The frame of a payload that is encoded already."""
        info = CATALOGUE.get(message_id)
        if info is None:
            raise InternalError(f"cannot encode message id {message_id}: not in the dialect")
        trimmed = payload.rstrip(b"\0") or payload[:1]
        body = (
            _HEADER_V2(
                MAGIC_V2,
                len(trimmed),
                0,
                0,
                self.next_sequence(),
                self.system_id,
                self.component_id,
                message_id & 0xFFFF,
                message_id >> 16,
            )
            + trimmed
        )
        return body + _CRC(crc16.mcrf4xx(body[1:] + bytes((info.crc_extra,))))


def rewrite(
    raw: bytes, sequence: int, system_id: int | None = None, component_id: int | None = None
) -> bytes:
    """``raw`` with another sequence number (and sender, where given) and the CRC that belongs to it.

    A signature covered the old bytes and is taken off. Raises PeerError where ``raw`` is not one
    whole frame or its id is not in the dialect, so that no CRC can be made.
    """
    frame = frame_of(raw)
    info = CATALOGUE.get(frame.message_id)
    if info is None:
        raise PeerError(f"cannot rewrite a frame of unknown message id {frame.message_id}")
    is_v2 = raw[0] == MAGIC_V2
    header = 4 if is_v2 else 2
    body = bytearray(raw[: len(raw) - (SIGNATURE_LENGTH if frame.signed else 0) - 2])
    if frame.signed:
        body[2] &= ~SIGNED_FLAG
    body[header] = sequence & 0xFF
    if system_id is not None:
        body[header + 1] = system_id
    if component_id is not None:
        body[header + 2] = component_id
    return bytes(body) + _CRC(crc16.mcrf4xx(bytes(body[1:]) + bytes((info.crc_extra,))))


def heartbeat() -> Any:
    """The station's own HEARTBEAT: a ground station, active."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


def command_int(
    target_system: int,
    target_component: int,
    command: int,
    *,
    frame: int = 0,
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    place: Geodetic | None = None,
    altitude_m: float | None = None,
) -> Any:
    """COMMAND_INT: ``params`` 1 to 4, ``place`` in param 5 to 7 (degE7, degE7, m).

    ``frame`` is a MAV_FRAME and says what the altitude is measured from; ``altitude_m`` takes the
    place of the AMSL one where the frame wants another.
    """
    x, y, z = 0, 0, 0.0
    if place is not None:
        x, y, z = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), place.altitude_amsl_m
    return dialect.MAVLink_command_int_message(
        target_system,
        target_component,
        frame,
        command,
        0,
        0,
        *params,
        x,
        y,
        z if altitude_m is None else altitude_m,
    )


def command_long(
    target_system: int,
    target_component: int,
    command: int,
    params: tuple[float, ...] = (),
    confirmation: int = 0,
) -> Any:
    """COMMAND_LONG with up to seven ``params``; ``confirmation`` counts the repeats."""
    filled = (*params, *(0.0,) * (7 - len(params)))
    return dialect.MAVLink_command_long_message(
        target_system, target_component, command, confirmation, *filled
    )


def set_message_interval(target_system: int, target_component: int, message_id: int, interval_us: int) -> Any:
    """Asks for a message every ``interval_us``; −1 stops it, 0 is the autopilot's default rate."""
    return command_long(
        target_system,
        target_component,
        dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
        (float(message_id), float(interval_us)),
    )


def timesync_request(sent_ns: int) -> Any:
    """Asks for a vehicle's time; its answer carries ``sent_ns`` back."""
    return dialect.MAVLink_timesync_message(0, sent_ns)


def timesync_reply(request_ts1: int, now_ns: int) -> Any:
    """The answer to a request: our time and the request's own ``ts1``."""
    return dialect.MAVLink_timesync_message(now_ns, request_ts1)


def cir_request(
    target_system: int,
    target_component: int,
    beacon_id: int,
    *,
    captures: int,
    interval_ms: int,
    first_tap: int = 0,
    tap_count: int = 0,
    encoding: int = 0,
) -> Any:
    """SAR_CIR_REQUEST; 0 means any beacon, a window around the first path, and (``interval_ms``) stop."""
    return dialect.MAVLink_sar_cir_request_message(
        target_system,
        target_component,
        beacon_id,
        first_tap,
        tap_count,
        encoding,
        captures,
        interval_ms,
    )


def target_estimate(target: TargetState, unix_us: int) -> Any:
    """SAR_TARGET_ESTIMATE of a belief, at ``unix_us`` of the wall clock."""
    place = target.position
    return dialect.MAVLink_sar_target_estimate_message(
        unix_us,
        target.beacon_id,
        round(place.latitude_deg * 1e7),
        round(place.longitude_deg * 1e7),
        round(place.altitude_amsl_m * 1e3),
        list(target.covariance_enu_m2),
        target.radius_90_m,
        int(target.environment),
        min(target.los_links, 255),
        min(target.links, 255),
        target.sequence & 0xFFFFFFFF,
    )
