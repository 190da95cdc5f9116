"""The websocket ``/api/v1/stream``: snapshot, then deltas and heartbeats.

Rule: one sender task a client; nothing a client does or fails to do holds up another one
or the station. A client that takes nothing for the set time is closed and counted.
"""

from __future__ import annotations

import asyncio
import logging
import re

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from groundstation.domain.errors import ResourceError
from groundstation.server.hub import Client, Hub

router = APIRouter()
logger = logging.getLogger(__name__)

CLOSE_TRY_AGAIN = 1013
_SINCE = re.compile(r"^([A-Za-z0-9_.-]{1,128}):([0-9]{1,15})$")


def parse_since(text: str | None) -> tuple[str, int] | None:
    """``EPOCH:SEQ``; None when absent or not of that form (the client then gets a snapshot)."""
    match = _SINCE.match(text or "")
    return (match[1], int(match[2])) if match else None


@router.websocket("/api/v1/stream")
async def stream(websocket: WebSocket, since: str | None = None) -> None:
    """Snapshot (or what was missed since ``EPOCH:SEQ``), then deltas."""
    hub: Hub = websocket.app.state.hub
    await websocket.accept()
    try:
        client = hub.attach(parse_since(since))
    except ResourceError as error:
        await websocket.close(CLOSE_TRY_AGAIN, str(error)[:120])
        return
    sender = asyncio.create_task(_send(websocket, client, hub), name="stream-sender")
    listener = asyncio.create_task(_listen(websocket), name="stream-listener")
    try:
        await asyncio.wait((sender, listener), return_when=asyncio.FIRST_COMPLETED)
    finally:
        hub.detach(client)
        for task in (sender, listener):
            task.cancel()
        await asyncio.gather(sender, listener, return_exceptions=True)


async def _send(websocket: WebSocket, client: Client, hub: Hub) -> None:
    timeout_s = hub.settings.send_timeout_s
    try:
        while True:
            item = await client.take()
            if client.overflowed:
                hub.clients_stalled_total += 1
                logger.warning("a page fell too many events behind and was closed")
                async with asyncio.timeout(timeout_s):
                    await websocket.close(CLOSE_TRY_AGAIN, "too many events behind")
                return
            # Not wait_for: before Python 3.12 it loses a cancellation that comes as it ends.
            async with asyncio.timeout(timeout_s):
                await websocket.send_text(item.json)
    except TimeoutError:
        hub.clients_stalled_total += 1
        logger.warning("a page took nothing for %.0f s and was closed", timeout_s)
    except (WebSocketDisconnect, RuntimeError):
        # The client left while a message was on its way: the listener sees the same.
        return


async def _listen(websocket: WebSocket) -> None:
    try:
        while True:
            # The page has nothing to say here; reading is how its leaving is noticed.
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
    except (WebSocketDisconnect, RuntimeError):
        return
