"""Records of the journal as bytes, and back, exactly.

Rule: what comes back equals what went in, or an error says why. A record on disk:

    marker u16 | kind u8 | reserved u8 | payload length u32 | seq u64 | time_ns i64 | unix_us i64
    payload
    CRC-32 u32 of all of the above

little-endian. A frame's payload is direction, connection name and the frame's own bytes;
every other kind is a JSON object with the fields of its dataclass. The CRC stands last, so
that a record whose writing was cut short can never look whole.
"""

from __future__ import annotations

import json
import math
import struct
import types
import typing
import zlib
from collections.abc import Callable, Hashable
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache, lru_cache
from typing import Any, cast, get_args, get_origin, get_type_hints

import orjson

from groundstation.domain.errors import InputError, InternalError
from groundstation.domain.inputs import (
    AnyInput,
    ConnectionInput,
    Direction,
    DropInput,
    FrameInput,
    JoinInput,
    MissionInput,
    OperatorInput,
    PlanInput,
    Record,
    SessionInput,
    TickInput,
)

MARKER = b"\xa7\x4a"
"""First bytes of each record: what a reader looks for behind damage."""
HEAD = struct.Struct("<2sBBIQqq")
CRC = struct.Struct("<I")
MAX_PAYLOAD = 16_000_000
"""Bytes. A longer length is damage, not a record."""

KIND_OF: dict[type[AnyInput], int] = {
    FrameInput: 1,
    TickInput: 2,
    MissionInput: 3,
    OperatorInput: 4,
    ConnectionInput: 5,
    DropInput: 6,
    PlanInput: 7,
    SessionInput: 8,
    JoinInput: 9,
}
"""Numbers on disk: never reused, never changed."""
CLASS_OF: dict[int, type[AnyInput]] = {number: kind for kind, number in KIND_OF.items()}
_FRAME = KIND_OF[FrameInput]
_FRAME_HEAD = struct.Struct("<BH")
_NON_FINITE = {"NaN": float("nan"), "Infinity": float("inf"), "-Infinity": float("-inf")}


def encode_record(record: Record) -> bytes:
    """Bytes of ``record`` as they stand in the journal.

    Raises:
        InternalError: a kind or value that the journal cannot hold.
    """
    entry = record.input
    kind = KIND_OF.get(type(entry))
    if kind is None:
        raise InternalError(f"the journal knows no input of kind {type(entry).__name__}")
    if isinstance(entry, FrameInput):
        payload = _frame_head(entry.direction is Direction.OUT, entry.connection) + entry.frame
    else:
        payload = dump_json(to_plain(entry))
    if len(payload) > MAX_PAYLOAD:
        raise InternalError(f"an input of {len(payload)} bytes; the journal holds up to {MAX_PAYLOAD}")
    try:
        head = HEAD.pack(MARKER, kind, 0, len(payload), record.seq, record.time_ns, record.unix_us)
    except struct.error as error:
        raise InternalError(f"record {record.seq} does not fit the journal: {error}") from error
    body = head + payload
    return body + CRC.pack(zlib.crc32(body))


def decode_record(kind: int, seq: int, time_ns: int, unix_us: int, payload: bytes) -> Record:
    """The record of a verified head and payload.

    Raises:
        InputError: written by a newer version of the program.
    """
    if kind == _FRAME:
        outward, length = _FRAME_HEAD.unpack_from(payload)
        start = _FRAME_HEAD.size + length
        name = _connection_name(payload[_FRAME_HEAD.size : start])
        frame = FrameInput(name, Direction.OUT if outward else Direction.IN, payload[start:])
        return Record(seq, time_ns, unix_us, frame)
    kind_class = CLASS_OF.get(kind)
    if kind_class is None:
        raise InputError(f"the journal has an input of kind {kind}; this version knows {sorted(CLASS_OF)}")
    return Record(seq, time_ns, unix_us, from_plain(kind_class, load_json(payload)))


@lru_cache(maxsize=256)
def _frame_head(outward: bool, connection: str) -> bytes:
    name = connection.encode("utf-8", "surrogatepass")
    if len(name) > 0xFFFF:
        raise InternalError(f"a connection's name of {len(name)} bytes; the journal holds up to 65535")
    return _FRAME_HEAD.pack(outward, len(name)) + name


@lru_cache(maxsize=256)
def _connection_name(name: bytes) -> str:
    return name.decode("utf-8", "surrogatepass")


def dump_json(plain: Any) -> bytes:
    """JSON of plain values; falls back to the standard library for text orjson refuses (lone surrogates)."""
    try:
        return orjson.dumps(plain)
    except TypeError:
        return json.dumps(plain, separators=(",", ":"), allow_nan=False).encode("ascii")


def load_json(data: bytes) -> Any:
    """Values of ``dump_json``."""
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError:
        return json.loads(data)


def to_plain(value: Any) -> Any:
    """``value`` as JSON can hold it: dataclasses as objects, tuples as lists, NaN and infinity as words."""
    if value is None or isinstance(value, bool | int):
        return int(value) if isinstance(value, Enum) else value
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return value
        return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: to_plain(getattr(value, item.name)) for item in fields(value)}
    raise InternalError(f"a value of type {type(value).__name__} cannot be journalled")


T = typing.TypeVar("T")


def from_plain(kind: type[T], plain: Any) -> T:
    """The inverse of ``to_plain`` for a dataclass ``kind``: typed by its annotations.

    A field that is missing takes its default (an older file); an unknown one is refused (a
    newer file, whose meaning we cannot guess).
    """
    value: T = _decoder(cast(Hashable, kind))(plain)
    return value


@cache
def _decoder(kind: Hashable) -> Callable[[Any], Any]:
    """A function from plain JSON to a value of the annotation ``kind``."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (typing.Union, types.UnionType):
        inner = [argument for argument in arguments if argument is not type(None)]
        if len(inner) != 1:
            raise InternalError(f"the journal cannot tell the members of {kind} apart")
        decode = _decoder(inner[0])
        return lambda plain: None if plain is None else decode(plain)
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            each = _decoder(arguments[0])
            return lambda plain: tuple(each(item) for item in plain)
        decoders = tuple(_decoder(argument) for argument in arguments)
        return lambda plain: tuple(one(item) for one, item in zip(decoders, plain, strict=True))
    if kind is float:
        return lambda plain: _NON_FINITE[plain] if isinstance(plain, str) else float(plain)
    if kind in (int, str, bool):
        return _exactly(kind)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind
    if isinstance(kind, type) and is_dataclass(kind):
        return _dataclass_decoder(kind)
    raise InternalError(f"the journal cannot hold a field of type {kind}")


def _exactly(kind: type) -> Callable[[Any], Any]:
    def decode(plain: Any) -> Any:
        if type(plain) is not kind:
            raise InputError(f"the journal has {plain!r} where {kind.__name__} is needed")
        return plain

    return decode


def _dataclass_decoder(kind: Any) -> Callable[[Any], Any]:
    hints = get_type_hints(kind)
    decoders = {item.name: _decoder(hints[item.name]) for item in fields(kind)}
    required = {
        item.name for item in fields(kind) if item.default is MISSING and item.default_factory is MISSING
    }

    def decode(plain: Any) -> Any:
        unknown = sorted(plain.keys() - decoders.keys())
        missing = sorted(required - plain.keys())
        if unknown or missing:
            raise InputError(
                f"the journal's {kind.__name__} has unknown fields {unknown} and lacks {missing}: "
                "it was written by another version of the program"
            )
        return kind(**{name: decoders[name](item) for name, item in plain.items()})

    return decode
