"""Claim: one core takes more than 30,000 frames a second from a connection's bytes to link windows.

Twenty vehicles hear five beacons each: heartbeat 1 Hz, attitude 10 Hz, position 5 Hz, and for each
beacon level and bearing 10 Hz, a 64-tap impulse response 1 Hz, in datagrams of up to 1,400 bytes.
Measured is bytes → framer → ingest → window, ticks included. Beside it, in the same run and over
the same bytes, the named alternative: pymavlink's ``parse_buffer`` alone, which only decodes.
Seconds are the process's CPU seconds: other work on the machine does not count.

    python benchmarks/bench_ingest.py [--seconds 20] [--repeat 3] [--out FILE.json]
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from pathlib import Path
from typing import Any

from reporting import environment, give

from groundstation.domain.inputs import Direction, FrameInput, Record, TickInput
from groundstation.domain.radio import LinkWindow
from groundstation.engine.ingest import Ingest
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.encode import Encoder
from groundstation.mavlink.framing import Framer

MS = 1_000_000
START_NS = 1_795_308_514_000_000_000
DATAGRAM = 1400


def traffic(seconds: int, vehicles: int, beacons: int) -> tuple[list[tuple[int, int, bytes]], int]:
    """(arrival ns, vehicle, datagram) in order, and the number of frames."""
    datagrams: list[tuple[int, int, bytes]] = []
    frames = 0
    senders = [(Encoder(v, 1), Encoder(v, 191)) for v in range(1, vehicles + 1)]
    taps = bytes(i % 180 for i in range(64)).ljust(212, b"\0")
    for step in range(seconds * 10):
        for index, (autopilot, sensor) in enumerate(senders):
            now_ns = START_NS + step * 100 * MS + index * MS
            boot_ms = 60_000 + step * 100 + index
            sensor_us = 7_200_000_000 + boot_ms * 1000
            lat = 470_000_000 + index * 10_000 + step * 40
            burst = []
            if step % 10 == 0:
                burst.append(autopilot.pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3)))
            attitude = (boot_ms, 0.01, 0.02, 0.01 * step, 0, 0, 0)
            burst.append(autopilot.pack(dialect.MAVLink_attitude_message(*attitude)))
            if step % 2 == 0:
                position = (boot_ms, lat, 80_000_000, 550_000, 50_000, 450, 0, 0, 0)
                burst.append(autopilot.pack(dialect.MAVLink_global_position_int_message(*position)))
            for beacon in range(beacons):
                level = -8500 + round(400 * math.sin(step * 0.7 + beacon))
                rss = (sensor_us, 1000 + beacon, 868_000_000, level, -11_000, step % 65536)
                burst.append(sensor.pack(dialect.MAVLink_sar_rss_message(*rss)))
                aoa = (sensor_us, 1000 + beacon, 0.3 + 0.001 * step, -0.5, 0.02, 0.02, 12)
                burst.append(sensor.pack(dialect.MAVLink_sar_aoa_message(*aoa)))
                if (step + 2 * beacon) % 10 == 0:
                    cir = (sensor_us, 1000 + beacon, 1.0, 0.5, 8.0, step % 65536, 0, 64, 0, 0, 1, 0, 64, taps)
                    burst.append(sensor.pack(dialect.MAVLink_sar_cir_message(*cir)))
            frames += len(burst)
            packet = b""
            for frame in burst:
                if len(packet) + len(frame) > DATAGRAM:
                    datagrams.append((now_ns, index, packet))
                    packet = b""
                packet += frame
            datagrams.append((now_ns, index, packet))
    return datagrams, frames


def through_ingest(datagrams: list[tuple[int, int, bytes]]) -> tuple[float, int, int]:
    """Seconds, windows and used frames of one pass."""
    ingest = Ingest()
    framers: dict[int, Framer] = {}
    names = [f"udpin:0.0.0.0:14550/{i}" for i in range(256)]
    seq = windows = 0
    next_tick_ns = START_NS
    begun = time.process_time()
    for now_ns, peer, datagram in datagrams:
        while next_tick_ns <= now_ns:
            out = ingest.handle(Record(seq, next_tick_ns, next_tick_ns // 1000, TickInput()))
            windows += sum(type(item) is LinkWindow for item in out)
            seq += 1
            next_tick_ns += 100 * MS
        framer = framers.get(peer)
        if framer is None:
            framer = framers[peer] = Framer()
        for frame in framer.feed(datagram):
            record = Record(seq, now_ns, now_ns // 1000, FrameInput(names[peer], Direction.IN, frame.raw))
            for item in ingest.handle(record):
                if type(item) is LinkWindow:
                    windows += 1
            seq += 1
    elapsed_s = time.process_time() - begun
    used = next(c.value for c in ingest.counters() if c.name == "frame_used_total")
    return elapsed_s, windows, used


def through_pymavlink(datagrams: list[tuple[int, int, bytes]]) -> tuple[float, int]:
    """Seconds and messages of the alternative."""
    parsers: dict[int, Any] = {}
    messages = 0
    begun = time.process_time()
    for _, peer, datagram in datagrams:
        parser = parsers.get(peer)
        if parser is None:
            parser = parsers[peer] = dialect.MAVLink(None)
        messages += len(parser.parse_buffer(datagram) or ())
    return time.process_time() - begun, messages


def main() -> int:
    """Measure, print, write."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=int, default=20)
    options.add_argument("--vehicles", type=int, default=20)
    options.add_argument("--beacons", type=int, default=5)
    options.add_argument("--repeat", type=int, default=3)
    options.add_argument("--out", type=Path)
    chosen = options.parse_args()
    datagrams, frames = traffic(chosen.seconds, chosen.vehicles, chosen.beacons)
    ours, theirs = [], []
    for _ in range(chosen.repeat):
        elapsed_s, windows, used = through_ingest(datagrams)
        if used != frames:
            print(f"only {used} of {frames} frames were used", file=sys.stderr)
            return 1
        ours.append(frames / elapsed_s)
        elapsed_s, messages = through_pymavlink(datagrams)
        if messages != frames:
            print(f"pymavlink read {messages} of {frames} frames", file=sys.stderr)
            return 1
        theirs.append(frames / elapsed_s)
    result = {
        "claim": "bytes to link windows on one core, frames per second",
        "frames": frames,
        "bytes": sum(len(datagram) for _, _, datagram in datagrams),
        "windows": windows,
        "vehicles": chosen.vehicles,
        "beacons": chosen.beacons,
        "traffic_s": chosen.seconds,
        "ingest_frames_per_s": round(statistics.median(ours)),
        "ingest_frames_per_s_all": [round(rate) for rate in ours],
        "pymavlink_parse_buffer_frames_per_s": round(statistics.median(theirs)),
        "ratio_to_pymavlink_decoding_only": round(statistics.median(ours) / statistics.median(theirs), 3),
        "times_real_time": round(chosen.seconds * statistics.median(ours) / frames, 1),
        "environment": environment("pymavlink"),
    }
    give(result, chosen.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
