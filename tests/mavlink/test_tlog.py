"""Recordings: what was written is read, a cut end is normal, garbage is an error that says where."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from pymavlink import mavutil

from groundstation.domain.errors import InputError, ResourceError
from groundstation.mavlink.encode import Encoder, heartbeat
from groundstation.mavlink.tlog import TlogWriter, read_tlog


def test_the_recording_is_read_whole(recording_path: Path) -> None:
    reader = read_tlog(recording_path)
    records = list(reader)
    assert len(records) == reader.records == 24_796
    assert reader.truncated_bytes == 0
    assert reader.position == recording_path.stat().st_size
    assert (records[-1][0] - records[0][0]) / 1e6 == pytest.approx(275, abs=2)
    assert all(later[0] >= earlier[0] for earlier, later in itertools.pairwise(records))


def test_rewriting_a_recording_gives_the_same_bytes(recording_path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.tlog"
    with TlogWriter(copy) as writer:
        for unix_us, frame in read_tlog(recording_path):
            writer.write(unix_us, frame)
    assert copy.read_bytes() == recording_path.read_bytes()


def test_pymavlink_reads_what_we_write(tmp_path: Path) -> None:
    path = tmp_path / "ours.tlog"
    encoder = Encoder(7, 1)
    with TlogWriter(path) as writer:
        for step in range(3):
            writer.write(1_700_000_000_000_000 + step * 500_000, encoder.pack(heartbeat()))
    log = mavutil.mavlink_connection(str(path))
    found = [log.recv_match(type="HEARTBEAT") for _ in range(3)]
    log.close()
    assert [message.get_srcSystem() for message in found] == [7, 7, 7]
    assert [message._timestamp for message in found] == [1_700_000_000.0, 1_700_000_000.5, 1_700_000_001.0]


@pytest.mark.parametrize("missing", [1, 12, 20, 28])
def test_a_cut_last_record_is_normal(recorded_frames: list[bytes], tmp_path: Path, missing: int) -> None:
    path = tmp_path / "cut.tlog"
    frames = [*recorded_frames[:50], Encoder(1, 1).pack(heartbeat())]
    with TlogWriter(path) as writer:
        for frame in frames:
            writer.write(1_700_000_000_000_000, frame)
    path.write_bytes(path.read_bytes()[:-missing])
    reader = read_tlog(path)
    assert [frame for _unix_us, frame in reader] == frames[:50]
    assert reader.truncated_bytes == 29 - missing


def test_appending(tmp_path: Path) -> None:
    path = tmp_path / "session.tlog"
    raw = Encoder(1, 1).pack(heartbeat())
    for append in (False, True):
        with TlogWriter(path, append=append) as writer:
            writer.write(1, raw)
            writer.flush()
    assert [frame for _unix_us, frame in read_tlog(path)] == [raw, raw]


def test_garbage_is_told_with_its_byte(recorded_frames: list[bytes], tmp_path: Path) -> None:
    path = tmp_path / "damaged.tlog"
    with TlogWriter(path) as writer:
        for frame in recorded_frames[:3]:
            writer.write(1_700_000_000_000_000, frame)
    at = path.stat().st_size
    path.write_bytes(path.read_bytes() + b"\0" * 8 + b"no frame begins here")
    records = iter(read_tlog(path))
    assert [next(records)[1] for _ in range(3)] == recorded_frames[:3]
    with pytest.raises(InputError, match=f"damaged at byte {at}: saw 00 00") as failure:
        next(records)
    assert "\n" not in str(failure.value)


@pytest.mark.parametrize("content", [b"", b"abc", b"PK\x03\x04 this is something else entirely"])
def test_another_kind_of_file(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.tlog"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"other\.tlog"):
        list(read_tlog(path))


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        list(read_tlog(tmp_path / "none.tlog"))
    with pytest.raises(ResourceError, match="cannot write"):
        TlogWriter(tmp_path / "none" / "x.tlog")
