"""A full disk: nothing raises, what waits is kept, what is lost is counted, all of it is told."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

# Run in a process of its own: the limit on file size holds for a whole process. EFBIG then
# takes the same way as ENOSPC on a full disk, in the middle of a write included.
SCRIPT = textwrap.dedent(
    """
    import resource, sys, time
    from pathlib import Path
    from groundstation.domain.inputs import Direction, FrameInput, Record
    from groundstation.store.journal import Journal, JournalReader
    from groundstation.store.settings import StoreSettings

    directory = Path(sys.argv[1])
    settings = StoreSettings(flush_interval_s=0.01, retry_interval_s=0.05, pending_bytes=int(sys.argv[2]))
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, hard))
    journal = Journal(directory, "s", settings)
    seq = 0

    def put(count):
        global seq
        for _ in range(count):
            journal.append(Record(seq, seq, seq, FrameInput("c", Direction.IN, bytes(100))))
            seq += 1

    def wait(condition):
        end = time.monotonic() + 10
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.005)

    put(100)
    wait(lambda: journal.failure is not None)
    first = journal.events(1)
    assert [(event.code, event.severity) for event in first] == [("journal.failed", "error")], first
    assert "File too large" in first[0].text and "goes on without it" in first[0].text
    assert journal.events(2) == []
    from groundstation.domain.errors import ResourceError
    try:
        journal.sync()
        raise AssertionError("sync must say that it failed")
    except ResourceError as error:
        assert "File too large" in str(error)
    put(20)
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    wait(lambda: journal.failure is None)
    second = journal.events(3)
    assert [event.code for event in second] == ["journal.recovered"], second
    put(10)
    journal.close()
    reader = JournalReader(directory)
    seqs = [record.seq for record in reader]
    print(len(seqs), seqs[-1], reader.missing_count, reader.torn_bytes + reader.damaged_bytes,
          journal.counters()[2].value, second[0].text)
    """
)


def run(directory: Path, pending_bytes: int) -> list[str]:
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(directory), str(pending_bytes)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return result.stdout.split(maxsplit=5)


def test_a_short_spell_of_a_full_disk_costs_nothing(tmp_path: Path) -> None:
    read, last, missing, damaged, dropped, text = run(tmp_path, 1_000_000)
    assert (int(read), int(last)) == (130, 129)
    assert int(missing) == int(damaged) == int(dropped) == 0
    assert "nothing is lost" in text


def test_a_long_spell_costs_what_memory_does_not_hold(tmp_path: Path) -> None:
    read, last, missing, damaged, dropped, text = run(tmp_path, 12_000)
    assert int(last) == 129
    assert int(dropped) > 0
    assert int(missing) == int(dropped) == 130 - int(read)
    assert int(damaged) == 0
    assert f"{dropped} entries are lost" in text
