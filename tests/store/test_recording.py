"""The session's .tlog: every frame, both directions, in the order of the journal."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from groundstation.domain.inputs import Direction, FrameInput, Record, TickInput
from groundstation.mavlink.tlog import read_tlog
from groundstation.store.recording import Recording
from groundstation.store.settings import StoreSettings


def test_frames_only_with_the_wall_clock(tmp_path: Path, frame_record: Callable[[int], Record]) -> None:
    recording = Recording(tmp_path, StoreSettings())
    records = [frame_record(0), Record(1, 1, 1, TickInput()), frame_record(2)]
    for record in records:
        recording.append(record)
    recording.close()
    expected = b""
    for record in (records[0], records[2]):
        assert isinstance(record.input, FrameInput)
        expected += struct.pack(">Q", record.unix_us) + record.input.frame
    assert (tmp_path / "frames.tlog").read_bytes() == expected
    assert recording.frames_count == 2


def test_a_later_run_begins_a_new_file(tmp_path: Path, frame_record: Callable[[int], Record]) -> None:
    for _ in range(2):
        recording = Recording(tmp_path, StoreSettings())
        recording.append(frame_record(0))
        recording.close()
    Recording(tmp_path, StoreSettings()).close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames-2.tlog", "frames.tlog"]


def test_other_tools_can_read_it(tmp_path: Path) -> None:
    frames = [bytes([0xFD, n, 0, 0, n, 1, 1, 0, 0, 0]) + bytes(n) + b"\x12\x34" for n in range(5)]
    recording = Recording(tmp_path, StoreSettings())
    for n, frame in enumerate(frames):
        recording.append(Record(n, n, 1_795_311_900_000_000 + n, FrameInput("udp", Direction.IN, frame)))
    recording.close()
    expected = [(1_795_311_900_000_000 + n, frame) for n, frame in enumerate(frames)]
    assert list(read_tlog(tmp_path / "frames.tlog")) == expected
