"""Serial ports: telemetry radios and autopilots on a cable.

The port is non-blocking in both directions: a radio that takes no bytes makes our queue full,
never the event loop wait. An unplugged device ends the connection; the supervisor tries again.
"""

from __future__ import annotations

import asyncio
import errno
import os

import serialx

from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.transport import Sink, StreamPeer
from groundstation.connections.urls import LinkUrl
from groundstation.domain.errors import GroundstationError, ResourceError


class SerialPeer(StreamPeer):
    """A StreamPeer whose end is told in words."""

    def __init__(self, sink: Sink, queue_bytes: int, device: str) -> None:
        super().__init__(sink, queue_bytes)
        self._device = device

    def connection_lost(self, error: Exception | None) -> None:
        """Called by serialx."""
        if error is None and self._closed.done():
            super().connection_lost(error)
            return
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        super().connection_lost(
            OSError(f"{self._device} was unplugged or failed ({reason or 'end of file'})")
        )


async def open_serial(url: LinkUrl, sink: Sink, settings: ConnectionSettings) -> SerialPeer:
    """Opens the port. Raises ResourceError: no such device, no rights, in use, not a serial port."""
    loop = asyncio.get_running_loop()
    peer = SerialPeer(sink, settings.serial_write_queue_bytes, url.device)
    try:
        await serialx.create_serial_connection(loop, lambda: peer, url.device, baudrate=url.baud)
    except Exception as error:
        if isinstance(error, (OSError, ValueError)):
            raise _open_error(url, error) from error
        raise
    return peer


def _open_error(url: LinkUrl, error: Exception) -> GroundstationError:
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or (
        url.device.startswith("/") and not os.path.exists(url.device)
    ):
        return ResourceError(f"{url.name}: no device {url.device}; is the radio plugged in?")
    if number in (errno.EACCES, errno.EPERM):
        return ResourceError(
            f"{url.name}: not allowed to open {url.device}; add yourself to its group (dialout)"
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return ResourceError(f"{url.name}: {url.device} is in use by another program")
    if number == errno.ENOTTY:
        return ResourceError(f"{url.name}: {url.device} is not a serial port")
    return ResourceError(f"{url.name}: cannot open {url.device}: {error}")
