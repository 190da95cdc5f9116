"""Decoding: each wanted message against pymavlink's own decoder, zeros cut or not."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.mavlink import messages as m
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.decode import WANTED_IDS, decode, quaternion_of_euler
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Frame, frame_of


def pymavlink_decodes(raw: bytes) -> Any:
    """The reference decoder's answer."""
    return dialect.MAVLink(None).decode(bytearray(raw))


def frame(message: Any) -> Frame:
    """A message as a verified frame."""
    return frame_of(Encoder(1, 1).pack(message))


def expected_of(ref: Any) -> m.Message | None:
    """What a reference message means in our types, written anew from the field names."""
    name = ref.get_type()
    if name == "HEARTBEAT":
        return m.Heartbeat(ref.type, ref.autopilot, ref.base_mode, ref.custom_mode, ref.system_status)
    if name == "SYS_STATUS":
        bit = dialect.MAV_SYS_STATUS_PREARM_CHECK
        return m.SysStatus(
            None if ref.voltage_battery == 65535 else ref.voltage_battery / 1000,
            None if ref.battery_remaining < 0 else float(ref.battery_remaining),
            all(
                word & bit
                for word in (
                    ref.onboard_control_sensors_present,
                    ref.onboard_control_sensors_enabled,
                    ref.onboard_control_sensors_health,
                )
            ),
        )
    if name == "SYSTEM_TIME":
        return m.SystemTime(ref.time_unix_usec or None, ref.time_boot_ms)
    if name == "GPS_RAW_INT":
        seen = None if ref.satellites_visible == 255 else ref.satellites_visible
        told = (None if mm in (0, 2**32 - 1) else mm / 1000 for mm in (ref.h_acc, ref.v_acc))
        return m.GpsRaw(ref.fix_type, seen, *told)
    if name == "GLOBAL_POSITION_INT":
        place = m.Geodetic(ref.lat / 1e7, ref.lon / 1e7, ref.alt / 1000)
        velocity = (ref.vx / 100, ref.vy / 100, ref.vz / 100)
        known = ref.lat != 0 or ref.lon != 0
        return m.GlobalPosition(ref.time_boot_ms, place if known else None, ref.relative_alt / 1000, velocity)
    if name == "COMMAND_ACK":
        progress = ref.progress if ref.result == 5 and ref.progress <= 100 else None
        return m.CommandAck(ref.command, ref.result, progress, ref.target_system, ref.target_component)
    if name == "POSITION_TARGET_GLOBAL_INT":
        place = m.Geodetic(ref.lat_int / 1e7, ref.lon_int / 1e7, ref.alt)
        usable = ref.type_mask & 7 == 0 and math.isfinite(ref.alt)
        return m.PositionTarget(ref.time_boot_ms, place if usable else None, ref.coordinate_frame)
    if name == "RADIO_STATUS":
        return m.RadioStatus(
            ref.rssi, ref.remrssi, ref.txbuf, ref.noise, ref.remnoise, ref.rxerrors, ref.fixed
        )
    if name == "TIMESYNC":
        return m.Timesync(ref.tc1, ref.ts1)
    if name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
        return m.EkfStatus(ref.flags)
    if name == "HOME_POSITION":
        return m.HomePosition(m.Geodetic(ref.latitude / 1e7, ref.longitude / 1e7, ref.altitude / 1000))
    if name == "EXTENDED_SYS_STATE":
        return m.ExtendedSysState(ref.landed_state)
    if name == "SAR_RSS":
        return m.RssSample(
            ref.time_usec,
            ref.beacon_id,
            ref.frequency_hz,
            None if ref.rss_cdbm == -32768 else ref.rss_cdbm / 100,
            None if ref.noise_cdbm == -32768 else ref.noise_cdbm / 100,
            ref.sequence,
        )
    if name == "SAR_AOA":
        angles = (ref.azimuth_rad, ref.elevation_rad, ref.azimuth_std_rad, ref.elevation_std_rad)
        return m.AoaSample(ref.time_usec, ref.beacon_id, *angles, ref.frame == dialect.MAV_FRAME_BODY_FRD)
    if name == "SAR_CIR":
        known = math.isfinite(ref.first_path_index)
        return m.CirFragment(
            ref.time_usec,
            ref.beacon_id,
            ref.tap_spacing_ns,
            ref.scale,
            ref.first_path_index if known else None,
            ref.capture_id,
            ref.first_tap,
            ref.tap_count,
            ref.offset,
            ref.fragment,
            ref.fragment_count,
            ref.encoding,
            bytes(ref.data)[: ref.length],
        )
    assert name == "SAR_LINK_STATE"
    return m.LinkStateReport(ref.time_usec, ref.beacon_id, ref.los_probability, ref.classifier_version)


PLAIN_IDS = sorted(WANTED_IDS - {30, 31, 253, 385})
"""Those whose meaning follows from the fields one by one; the others have tests of their own."""


def same(one: object, other: object) -> bool:
    """Equality in which NaN equals NaN."""
    return repr(one) == repr(other)


@pytest.mark.parametrize("message_id", PLAIN_IDS, ids=lambda i: CATALOGUE[i].name)
@settings(max_examples=60)
@given(data=st.data())
def test_agrees_with_pymavlink(message_id: int, data: st.DataObject) -> None:
    length = CATALOGUE[message_id].length
    # Short payloads: MAVLink 2 cuts trailing zeros wherever they begin.
    payload = data.draw(st.binary(min_size=0, max_size=length))
    raw = Encoder(1, 1).pack_payload(message_id, payload or b"\0")
    assert same(decode(frame_of(raw)), expected_of(pymavlink_decodes(raw)))


def test_every_wanted_message_of_the_recording_agrees(recorded_frames: list[bytes]) -> None:
    seen: Counter[int] = Counter()
    for raw in recorded_frames[::7]:
        found = frame_of(raw)
        if found.message_id in PLAIN_IDS:
            assert same(decode(found), expected_of(pymavlink_decodes(raw)))
            seen[found.message_id] += 1
        elif found.message_id not in WANTED_IDS:
            assert decode(found) is None
    assert {0, 1, 2, 24, 33, 193} <= set(seen)


def test_a_payload_from_a_newer_dialect_is_read_as_far_as_known() -> None:
    raw = Encoder(1, 1).pack_payload(2, bytes(range(1, 21)))
    assert decode(frame_of(raw)) == m.SystemTime(0x0807060504030201, 0x0C0B0A09)


@pytest.mark.parametrize(("told_mm", "expected_m"), [(0, None), (1, 0.001), (2**32 - 1, None)])
def test_a_place_s_accuracy_of_nothing_or_of_all_ones_is_unknown(
    told_mm: int, expected_m: float | None
) -> None:
    message = dialect.MAVLink_gps_raw_int_message(0, 3, 0, 0, 0, 0, 0, 0, 0, 9, h_acc=told_mm, v_acc=told_mm)
    assert decode(frame(message)) == m.GpsRaw(3, 9, expected_m, expected_m)


def test_statustext_ends_at_its_first_zero() -> None:
    assert decode(frame(dialect.MAVLink_statustext_message(2, b"Arm: GPS 1: Bad fix", 7, 1))) == m.StatusText(
        2, "Arm: GPS 1: Bad fix", 7, 1
    )
    full = b"x" * 50
    assert decode(frame(dialect.MAVLink_statustext_message(6, full))) == m.StatusText(6, "x" * 50, 0, 0)
    bad = decode(frame(dialect.MAVLink_statustext_message(6, b"\xff\xfe!")))
    assert isinstance(bad, m.StatusText)
    assert bad.text.endswith("!")


@given(st.tuples(*[st.floats(-3.125, 3.125, width=32)] * 3))
def test_attitude_is_the_rotation_of_its_angles(angles: tuple[float, float, float]) -> None:
    roll, pitch, yaw = angles
    decoded = decode(frame(dialect.MAVLink_attitude_message(123, roll, pitch, yaw, 0.0, 0.0, 0.0)))
    assert isinstance(decoded, m.Attitude)
    w, x, y, z = decoded.attitude
    # The direction cosine matrix of yaw, pitch, roll, written down independently.
    cr, sr, cp, sp, cy, sy = (f(a) for a in angles for f in (math.cos, math.sin))
    nose = (cp * cy, cp * sy, -sp)
    belly = (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp)
    assert (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)) == pytest.approx(
        nose, abs=1e-6
    )
    assert (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)) == pytest.approx(
        belly, abs=1e-6
    )


def test_attitude_quaternion_is_normalised_and_nonsense_is_none() -> None:
    w, x, y, z = quaternion_of_euler(0.1, -0.2, 2.0)
    scaled = [1.01 * part for part in (w, x, y, z)]
    message = decode(frame(dialect.MAVLink_attitude_quaternion_message(9, *scaled, 0.0, 0.0, 0.0)))
    assert isinstance(message, m.Attitude)
    assert message.attitude == pytest.approx((w, x, y, z), abs=1e-6)
    assert decode(frame(dialect.MAVLink_attitude_quaternion_message(9, *[0.0] * 7))) is None
    assert decode(frame(dialect.MAVLink_attitude_message(9, math.nan, *[0.0] * 5))) is None
