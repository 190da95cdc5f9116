"""Our messages inside TUNNEL (385), for routers that drop ids they do not know.

``payload_type`` 52080; the payload is the message id (uint16, little-endian), then the message's
payload with its zeros, at most 126 bytes: a SAR_CIR carries at most 86 bytes of data and is cut
off behind them.
"""

from __future__ import annotations

from struct import Struct
from typing import Any

from groundstation.domain.errors import InternalError

TUNNEL_ID = 385
TUNNEL_PAYLOAD_TYPE = 52080
MAX_INNER_LENGTH = 126
MAX_CIR_DATA_LENGTH = 86
"""Bytes of SAR_CIR data that fit."""

_CIR_ID = 20802
_CIR_FIXED_LENGTH = 40
_HEADER = Struct("<HBBB")
_INNER_ID = Struct("<H")


def unwrap(payload: bytes) -> tuple[int, bytes] | None:
    """(message id, its payload) of a TUNNEL's payload; None where it is not one of ours."""
    if len(payload) < _HEADER.size:
        payload = payload.ljust(_HEADER.size, b"\0")
    payload_type, _system, _component, length = _HEADER.unpack_from(payload)
    if payload_type != TUNNEL_PAYLOAD_TYPE or not _INNER_ID.size <= length <= 128:
        return None
    # The tunnel's own trailing zeros were cut on the wire and belong to the inner message.
    inner = payload[_HEADER.size : _HEADER.size + length].ljust(length, b"\0")
    return int(_INNER_ID.unpack_from(inner)[0]), inner[_INNER_ID.size :]


def wrap(message: Any, target_system: int = 0, target_component: int = 0) -> Any:
    """The TUNNEL message that carries ``message`` (one of the dialect's), for everyone by default.

    Raises InternalError where it is longer than a tunnel; of a SAR_CIR the ``length`` decides.
    """
    from groundstation.mavlink.dialect import dialect
    from groundstation.mavlink.encode import payload_of

    payload = payload_of(message)
    if message.get_msgId() == _CIR_ID:
        payload = payload[: _CIR_FIXED_LENGTH + message.length]
    if len(payload) > MAX_INNER_LENGTH:
        raise InternalError(
            f"{message.get_type()} has {len(payload)} bytes; a tunnel carries {MAX_INNER_LENGTH}"
            f" (SAR_CIR: {MAX_CIR_DATA_LENGTH} bytes of data)"
        )
    inner = _INNER_ID.pack(message.get_msgId()) + payload
    return dialect.MAVLink_tunnel_message(
        target_system, target_component, TUNNEL_PAYLOAD_TYPE, len(inner), list(inner.ljust(128, b"\0"))
    )
