"""Generating the dialect: repeatable, clear when it cannot be, and ids and fields as documented."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.domain.errors import InternalError, ResourceError
from groundstation.mavlink.catalogue import CATALOGUE
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.generate import DEFINITIONS_PATH, OUTPUT_FOLDER, generate


def test_the_same_input_gives_the_same_bytes_and_the_tree_is_up_to_date(tmp_path: Path) -> None:
    generate(tmp_path / "one")
    for name in ("__init__.py", "message_table.py", "sar_radio.py"):
        fresh = (tmp_path / "one" / name).read_bytes()
        assert fresh == (OUTPUT_FOLDER / name).read_bytes(), "run: python -m groundstation.mavlink.generate"
        assert str(tmp_path).encode() not in fresh


def test_wrong_definitions_are_told_in_one_line(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.xml"
    text = DEFINITIONS_PATH.read_text(encoding="utf-8")
    wrong.write_text(text.replace('type="int16_t"', 'type="int17_t"', 1), encoding="utf-8")
    with pytest.raises(InternalError, match="not valid MAVLink") as failure:
        generate(tmp_path / "out", wrong)
    assert "\n" not in str(failure.value)
    assert not (tmp_path / "out").exists()


def test_an_unwritable_folder_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ResourceError, match="cannot write the MAVLink dialect"):
        generate(tmp_path / "file" / "generated")


SAR_FIELDS = {
    20800: ("SAR_RSS", 26, ["time_usec", "beacon_id", "frequency_hz", "rss_cdbm", "noise_cdbm", "sequence"]),
    20801: (
        "SAR_AOA",
        33,
        [
            *("time_usec", "beacon_id", "azimuth_rad", "elevation_rad"),
            *("azimuth_std_rad", "elevation_std_rad", "frame"),
        ],
    ),
    20802: (
        "SAR_CIR",
        252,
        [
            *("time_usec", "beacon_id", "tap_spacing_ns", "scale", "first_path_index", "capture_id"),
            *("first_tap", "tap_count", "offset", "fragment", "fragment_count", "encoding", "length", "data"),
        ],
    ),
    20803: ("SAR_LINK_STATE", 24, ["time_usec", "beacon_id", "los_probability", "classifier_version"]),
    20804: (
        "SAR_CIR_REQUEST",
        18,
        [
            *("target_system", "target_component", "beacon_id", "first_tap", "tap_count"),
            *("encoding", "captures", "interval_ms"),
        ],
    ),
    20805: (
        "SAR_TARGET_ESTIMATE",
        63,
        [
            *("time_usec", "beacon_id", "lat", "lon", "alt", "covariance_enu", "radius_90_m"),
            *("environment", "los_links", "links", "sequence"),
        ],
    ),
}


@pytest.mark.parametrize("message_id", SAR_FIELDS)
def test_our_messages_are_the_contract(message_id: int) -> None:
    name, length, fields = SAR_FIELDS[message_id]
    info = CATALOGUE[message_id]
    assert (info.name, info.base_length, info.length) == (name, length, length)
    assert dialect.mavlink_map[message_id].fieldnames == fields


def test_crc_extras_are_frozen() -> None:
    # Sensors outside the project were built against these: a change here breaks every one of them.
    assert {i: CATALOGUE[i].crc_extra for i in SAR_FIELDS} == CRC_EXTRAS


def test_catalogue_agrees_with_the_module() -> None:
    assert set(CATALOGUE) == set(dialect.mavlink_map)
    for message_id, info in CATALOGUE.items():
        cls = dialect.mavlink_map[message_id]
        assert (info.name, info.crc_extra, info.length) == (cls.msgname, cls.crc_extra, cls.unpacker.size)


CRC_EXTRAS = {20800: 80, 20801: 81, 20802: 199, 20803: 72, 20804: 136, 20805: 41}
