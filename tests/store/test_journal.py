"""The journal: what was written comes back; damage costs what it touched and no more."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from groundstation.domain.errors import InputError
from groundstation.domain.inputs import Decision, OperatorInput, Record, TickInput
from groundstation.store.codec import CRC, HEAD, encode_record
from groundstation.store.journal import Journal, JournalReader, journal_files
from groundstation.store.settings import StoreSettings

MakeRecord = Callable[[int], Record]


def write(directory: Path, records: list[Record], settings: StoreSettings | None = None) -> None:
    journal = Journal(directory, "session-1", settings)
    for record in records:
        journal.append(record)
    journal.close()


def test_reads_back_what_was_written(tmp_path: Path, frame_record: MakeRecord) -> None:
    records = [frame_record(seq) for seq in range(50)]
    write(tmp_path / "journal", records)
    reader = JournalReader(tmp_path)
    assert list(reader) == records
    assert reader.session_id == "session-1"
    assert reader.damage() == ""
    assert list(JournalReader(tmp_path, after_seq=46)) == records[47:]


def test_torn_at_every_byte_of_the_last_record(tmp_path: Path, frame_record: MakeRecord) -> None:
    records = [frame_record(seq) for seq in range(4)]
    write(tmp_path, records)
    path = journal_files(tmp_path)[0]
    whole = path.read_bytes()
    size = len(encode_record(records[-1]))
    for cut in range(1, size + 1):
        path.write_bytes(whole[:-cut])
        reader = JournalReader(path)
        assert list(reader) == records[:-1]
        assert reader.torn_bytes == size - cut
        assert reader.damaged_bytes == reader.missing_count == 0


def test_a_flipped_bit_anywhere_costs_at_most_the_record_it_hit(
    tmp_path: Path, frame_record: MakeRecord
) -> None:
    records = [frame_record(seq) for seq in range(4)]
    write(tmp_path, records)
    path = journal_files(tmp_path)[0]
    whole = path.read_bytes()
    first = whole.index(encode_record(records[0]))
    for position in range(first, len(whole)):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << (position % 8)
        path.write_bytes(damaged)
        reader = JournalReader(tmp_path)
        back = list(reader)
        assert len(back) == 3
        assert all(record in records for record in back)
        assert reader.damaged_bytes + reader.torn_bytes > 0
        assert reader.damage() != ""
        if back[-1] == records[-1]:
            assert reader.missing_count == 1


def test_a_damaged_header_does_not_cost_the_records(tmp_path: Path, frame_record: MakeRecord) -> None:
    records = [frame_record(seq) for seq in range(4)]
    write(tmp_path, records)
    path = journal_files(tmp_path)[0]
    data = bytearray(path.read_bytes())
    data[25] ^= 0xFF
    path.write_bytes(data)
    reader = JournalReader(tmp_path)
    assert list(reader) == records
    assert reader.damaged_bytes > 0


@pytest.mark.parametrize("size", [0, 1, 10, 30])
def test_a_file_cut_within_its_header_is_counted(tmp_path: Path, frame_record: MakeRecord, size: int) -> None:
    records = [frame_record(seq) for seq in range(4)]
    write(tmp_path, records[:3])
    write(tmp_path, records[3:])
    second = journal_files(tmp_path)[1]
    second.write_bytes(second.read_bytes()[:size])
    reader = JournalReader(tmp_path)
    assert list(reader) == records[:3]
    assert reader.torn_bytes == size


def test_goes_on_in_a_new_file_behind_a_torn_one(tmp_path: Path, frame_record: MakeRecord) -> None:
    records = [frame_record(seq) for seq in range(6)]
    write(tmp_path, records[:4])
    first = journal_files(tmp_path)[0]
    first.write_bytes(first.read_bytes()[:-3])
    write(tmp_path, records[3:])
    reader = JournalReader(tmp_path)
    assert list(reader) == records
    assert (reader.torn_bytes, reader.missing_count, reader.repeated_count) == (
        len(encode_record(records[3])) - 3,
        0,
        0,
    )


def test_rotates_by_size_and_skips_files_that_are_not_asked_for(
    tmp_path: Path, frame_record: MakeRecord
) -> None:
    settings = StoreSettings(segment_bytes=500)
    journal = Journal(tmp_path, "s", settings)
    records = [frame_record(seq) for seq in range(40)]
    for record in records:
        journal.append(record)
        if record.seq % 5 == 4:
            journal.sync()
    journal.close()
    files = journal_files(tmp_path)
    assert len(files) == 8
    assert all(path.stat().st_size < 700 for path in files)
    assert list(JournalReader(tmp_path)) == records
    files[0].write_bytes(b"")
    reader = JournalReader(tmp_path, after_seq=21)
    assert list(reader) == records[22:]
    assert reader.damage() == ""


def test_missing_and_repeated_records_are_counted(tmp_path: Path, frame_record: MakeRecord) -> None:
    write(tmp_path, [frame_record(seq) for seq in (2, 3, 7, 7, 8)])
    reader = JournalReader(tmp_path)
    assert [record.seq for record in reader] == [2, 3, 7, 8]
    assert reader.missing_count == 2 + 3
    assert reader.repeated_count == 1
    assert {counter.name: counter.value for counter in reader.counters()}[
        "journal_missing_records_total"
    ] == 5


def test_not_a_journal(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no journal here"):
        JournalReader(tmp_path)
    strange = tmp_path / "000001.journal"
    strange.write_bytes(b"PK\x03\x04 and so on, for longer than a header is")
    with pytest.raises(InputError, match="not a journal"):
        list(JournalReader(tmp_path))


def test_a_newer_format_is_refused(
    tmp_path: Path, frame_record: MakeRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.store.journal.FORMAT_VERSION", 2)
    write(tmp_path, [frame_record(0)])
    monkeypatch.undo()
    with pytest.raises(InputError, match="journal format 2; this version reads 1"):
        list(JournalReader(tmp_path))


def wait_for_count(path: Path, count: int, within_s: float) -> float:
    start = time.monotonic()
    while time.monotonic() - start < within_s:
        try:
            if sum(1 for _ in JournalReader(path)) >= count:
                return time.monotonic() - start
        except InputError:
            pass
        time.sleep(0.01)
    raise AssertionError(f"{count} records did not reach the file within {within_s} s")


def test_frames_reach_the_system_within_half_a_second(tmp_path: Path, frame_record: MakeRecord) -> None:
    journal = Journal(tmp_path, "s")
    journal.append(frame_record(0))
    # The interval is 0.2 s; the rest is what a loaded machine may take to run the thread.
    assert wait_for_count(tmp_path, 1, 2.0) < 1.0
    journal.close()


def test_an_operators_action_does_not_wait_for_the_interval(tmp_path: Path) -> None:
    journal = Journal(tmp_path, "s", StoreSettings(flush_interval_s=30.0))
    journal.append(Record(0, 1, 1, TickInput()))
    journal.append(Record(1, 1, 1, OperatorInput("ann", Decision.HOLD_ALL)))
    wait_for_count(tmp_path, 2, 5.0)
    journal.close()


WRITER = textwrap.dedent(
    """
    import sys, time
    from pathlib import Path
    from groundstation.domain.inputs import Direction, FrameInput, Record
    from groundstation.store.journal import Journal
    journal = Journal(Path(sys.argv[1]), "s")
    seq = 0
    while True:
        for _ in range(50):
            now = time.time_ns()
            journal.append(Record(seq, now, now // 1000, FrameInput("c", Direction.IN, bytes(100))))
            seq += 1
        time.sleep(0.005)
    """
)


def test_a_killed_writer_loses_no_more_than_the_flush_interval(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)])
    try:
        wait_for_count(tmp_path, 5_000, 30.0)
    finally:
        killed_ns = time.time_ns()
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    reader = JournalReader(tmp_path)
    records = list(reader)
    assert [record.seq for record in records] == list(range(len(records)))
    # The interval is 0.2 s; the rest is what a loaded machine may take to run the thread.
    assert (killed_ns - records[-1].time_ns) / 1e9 < 1.0
    assert reader.missing_count == reader.damaged_bytes == 0


def test_record_heads_do_not_change_between_versions() -> None:
    # Files in the field are read by later versions: this layout is a promise.
    data = encode_record(Record(7, 8, 9, TickInput()))
    assert (
        data[: HEAD.size].hex()
        == "a74a020002000000" + "0700000000000000" + "0800000000000000" + "0900000000000000"
    )
    assert data[HEAD.size : -CRC.size] == b"{}"
