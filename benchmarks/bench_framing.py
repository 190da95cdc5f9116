"""Claim: bytes become typed messages several times faster than with pymavlink, on one core.

Both read the same stream in the same run, in chunks of 4 kB, in turns; the best of each counts,
and the ratio is what carries from machine to machine. The stream is the recorded flight of four
ArduCopters with full-size impulse response fragments mixed in.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from reporting import environment, give

from groundstation.mavlink.decode import decode
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.duplicates import DuplicateFilter
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Framer
from groundstation.mavlink.tlog import read_tlog

CHUNK_BYTES = 4096
RECORDING = Path(__file__).parents[1] / "tests" / "data" / "arducopter-4x.tlog"


def stream_of(frames: int) -> bytes:
    """The recording's frames, every tenth followed by a SAR_CIR fragment."""
    sensor = Encoder(1, 191)
    fragment = bytes(range(1, 253))
    parts: list[bytes] = []
    for index, (_unix_us, raw) in enumerate(read_tlog(RECORDING)):
        parts.append(raw)
        if index % 10 == 0:
            parts.append(sensor.pack_payload(20802, fragment))
        if len(parts) >= frames:
            break
    return b"".join(parts)


def ours(chunks: list[bytes], with_decode: bool, with_duplicates: bool) -> int:
    """Frames that our framer (and decoder) made of the stream."""
    framer = Framer(DuplicateFilter() if with_duplicates else None)
    count = 0
    for chunk in chunks:
        found = framer.feed(chunk)
        count += len(found)
        if with_decode:
            for frame in found:
                decode(frame)
    return count


def theirs(chunks: list[bytes]) -> int:
    """Messages that pymavlink made of it (it cannot frame without decoding)."""
    parser = dialect.MAVLink(None)
    return sum(len(parser.parse_buffer(chunk) or ()) for chunk in chunks)


def main() -> int:
    """Prints one JSON object."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--frames", type=int, default=25_000)
    options.add_argument("--rounds", type=int, default=3)
    given = options.parse_args()
    stream = stream_of(given.frames)
    chunks = [stream[at : at + CHUNK_BYTES] for at in range(0, len(stream), CHUNK_BYTES)]
    ways: dict[str, Callable[[], int]] = {
        "framer": lambda: ours(chunks, with_decode=False, with_duplicates=False),
        "framer_duplicates": lambda: ours(chunks, with_decode=False, with_duplicates=True),
        "framer_duplicates_decode": lambda: ours(chunks, with_decode=True, with_duplicates=True),
        "pymavlink": lambda: theirs(chunks),
    }
    counts: dict[str, int] = {}
    best_s: dict[str, float] = dict.fromkeys(ways, float("inf"))
    for _ in range(given.rounds):
        for name, way in ways.items():
            begun = time.process_time()
            counts[name] = way()
            best_s[name] = min(best_s[name], time.process_time() - begun)
    if len(set(counts.values())) != 1:
        print(f"error: not the same number of frames: {counts}", file=sys.stderr)
        return 1
    rates = {name: counts[name] / seconds for name, seconds in best_s.items()}
    result = {
        "benchmark": "framing",
        "frames": counts["framer"],
        "bytes": len(stream),
        "frames_per_s": {name: round(rate) for name, rate in rates.items()},
        "ratio_to_pymavlink": {
            name: round(rate / rates["pymavlink"], 2) for name, rate in rates.items() if name != "pymavlink"
        },
        "environment": environment("pymavlink"),
    }
    give(result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
