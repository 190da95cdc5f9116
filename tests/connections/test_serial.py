"""Serial ports, on a pseudo-terminal: reading, writing, unplugging, plugging in again."""

from __future__ import annotations

import os
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from groundstation.mavlink import encode
from groundstation.mavlink.encode import Encoder


class Radio:
    """A pseudo-terminal whose device name stays the same from plug to plug."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.controller = -1

    def plug_in(self) -> None:
        """Makes the device appear."""
        self.controller, terminal = os.openpty()
        tty.setraw(terminal)
        os.set_blocking(self.controller, False)
        self.device.symlink_to(os.ttyname(terminal))
        os.close(terminal)

    def unplug(self) -> None:
        """Makes it vanish, open or not."""
        if self.controller >= 0:
            self.device.unlink()
            os.close(self.controller)
            self.controller = -1


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[Radio]:
    """Plugged in."""
    made = Radio(tmp_path / "ttyRadio")
    made.plug_in()
    yield made
    made.unplug()


def read(radio: Radio) -> bytes:
    """What the station wrote."""
    try:
        return os.read(radio.controller, 65_536)
    except BlockingIOError:
        return b""


async def test_read_write_unplug_and_plug_in_again(run_hub: Any, radio: Radio) -> None:
    url = f"serial:{radio.device}:57600"
    vehicle = Encoder(1, 1)
    async with run_hub([url]) as running:
        await running.is_open()
        raw = vehicle.pack(encode.heartbeat())
        for piece in (b"\xfd\xfe noise", raw[:7], raw[7:]):
            os.write(radio.controller, piece)
        await running.until(lambda: running.heard, "the heartbeat")
        command = Encoder().pack(encode.command_long(1, 1, 400))
        assert running.hub.send(command) == 1
        written = bytearray()
        await running.until(lambda: written.extend(read(radio)) or bytes(written) == command, "the command")

        radio.unplug()
        await running.until(lambda: not running.hub.is_open(url), "the loss noticed")
        await running.until(lambda: running.states[-1][1] == "waiting", "the next try announced")
        closed = next(detail for _name, state, detail in running.states if state == "closed")
        assert "was unplugged or failed" in closed
        assert running.hub.send(command) == 0
        await running.until(
            lambda: "is the radio plugged in?" in running.states[-1][2], "the missing device told"
        )

        radio.plug_in()
        await running.is_open()
        os.write(radio.controller, vehicle.pack(encode.heartbeat()))
        await running.until(lambda: len(running.heard) == 2, "heard again")
        assert running.hub.send(command) == 1


async def test_a_radio_that_takes_no_bytes_blocks_nothing(run_hub: Any, radio: Radio) -> None:
    url = f"serial:{radio.device}:57600"
    async with run_hub([url]) as running:
        await running.is_open()
        frame = Encoder().pack_payload(20802, bytes([7]) * 252)
        sent = 0
        while running.hub.send(frame) and sent < 10_000:
            sent += 1
        assert 4_096 // len(frame) <= sent < 10_000
        assert running.counter("connection_refused_frames_total") == 1
        # It still reads, and what waited leaves when the radio takes it.
        os.write(radio.controller, Encoder(1, 1).pack(encode.heartbeat()))
        await running.until(lambda: running.heard, "the heartbeat")
        drained = bytearray()
        await running.until(
            lambda: drained.extend(read(radio)) or len(drained) == sent * len(frame), "drained"
        )
        assert running.hub.send(frame) == 1


async def test_a_missing_device_and_a_plain_file(run_hub: Any, tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("not a port")
    missing, plain = f"serial:{tmp_path}/ttyNone:57600", f"serial:{tmp_path}/plain:57600"
    async with run_hub([missing, plain]) as running:
        await running.until(lambda: len(running.states) >= 2, "both told")
        told = {name: detail for name, _state, detail in running.states}
        assert "no device" in told[missing]
        assert "is the radio plugged in?" in told[missing]
        assert "is not a serial port" in told[plain]
        assert not any("\n" in detail for detail in told.values())
