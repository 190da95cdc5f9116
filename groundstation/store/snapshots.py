"""The engines' whole state at one record, so that a restart need not read the whole journal.

Rule: a snapshot is whole or it is not there. It is written beside its final name, put on
the disk and renamed; one CRC covers all of it; a damaged one is skipped, loudly, and the
one before it is used. Nothing in it can run code. A file is

    magic "GSSNAP\\r\\n" | format version u16 | reserved u16 | seq u64 | time_ns i64 | JSON length u64
    JSON | arrays, C order, each at a multiple of 8 from the first | CRC-32 u32

little-endian; the JSON has ``tree`` and ``arrays`` (dtype, shape, offset of each). In the
tree, what JSON cannot say is an object of one key that begins with ``$``.
"""

from __future__ import annotations

import base64
import math
import os
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.domain.errors import InputError, InternalError, ResourceError
from groundstation.domain.events import Event, Severity
from groundstation.store.codec import dump_json, load_json
from groundstation.store.writer import sync_directory

FORMAT_VERSION = 1
MAGIC = b"GSSNAP\r\n"
_HEADER = struct.Struct("<8sHHQqQ")
_CRC = struct.Struct("<I")
_ALIGN = 8
_INT64 = 2**63
_ARRAY_KINDS = "biufcSU"
_SUFFIX = ".snapshot"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State as it was after the record ``seq`` had been handled."""

    seq: int
    """Journal sequence number of the last record that the state includes."""
    time_ns: int
    """Station time of that record."""
    state: Any
    """Tree of dict, list and leaves: None, bool, int, float, str, bytes, tuple, numpy array."""


class SnapshotStore:
    """The snapshots of one session: keeps the newest few."""

    def __init__(self, directory: Path, keep: int = 3) -> None:
        self._directory = directory
        self._keep = max(1, keep)

    def save(self, snapshot: Snapshot) -> Path:
        """Write it and delete those no longer kept. Blocks. Raises ResourceError, InternalError."""
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResourceError(f"cannot write {self._directory}: {error.strerror}") from error
        path = self._directory / f"{snapshot.seq:012d}{_SUFFIX}"
        save_snapshot(path, snapshot)
        for old in self._paths()[self._keep :]:
            old.unlink(missing_ok=True)
        return path

    def newest(self, time_ns: int = 0) -> tuple[Snapshot | None, list[Event]]:
        """The newest whole snapshot, and a warning for each damaged one that was passed over."""
        events: list[Event] = []
        for path in self._paths():
            try:
                return load_snapshot(path), events
            except (InputError, ResourceError) as error:
                text = f"Snapshot passed over: {error}; an older one is used, starting takes longer"
                events.append(Event(time_ns, "snapshot.damaged", Severity.WARNING, text))
        return None, events

    def _paths(self) -> list[Path]:
        return sorted(self._directory.glob(f"*{_SUFFIX}"), reverse=True)


def save_snapshot(path: Path, snapshot: Snapshot) -> None:
    """Write ``snapshot`` to ``path``, whole or not at all. Blocks until it is on the disk.

    Raises:
        ResourceError: the disk refused.
        InternalError: the state holds something that is not a leaf of such a tree.
    """
    data = encode_snapshot(snapshot)
    write_atomically(path, data)


def write_atomically(path: Path, data: bytes) -> None:
    """Replace ``path`` by ``data``, whole or not at all, on the disk. Raises ResourceError."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_directory(path.parent)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ResourceError(f"cannot write {path}: {error.strerror or error}") from error


def load_snapshot(path: Path) -> Snapshot:
    """Read a snapshot.

    Raises:
        InputError: damaged, of another format version, or no snapshot.
        ResourceError: it cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ResourceError(f"cannot read {path}: {error.strerror}") from error
    return decode_snapshot(data, str(path))


def encode_snapshot(snapshot: Snapshot) -> bytes:
    """The bytes of a snapshot file: equal states give equal bytes."""
    packer = _Packer()
    tree = packer.plain(snapshot.state, "state")
    text = dump_json({"tree": tree, "arrays": packer.manifest})
    header = _HEADER.pack(MAGIC, FORMAT_VERSION, 0, snapshot.seq, snapshot.time_ns, len(text))
    body = b"".join([header, text, *packer.chunks])
    return body + _CRC.pack(zlib.crc32(body))


def decode_snapshot(data: bytes, name: str) -> Snapshot:
    """The inverse of ``encode_snapshot``; ``name`` is for the error's text. Raises InputError."""
    if len(data) < _HEADER.size + _CRC.size or not data.startswith(MAGIC):
        raise InputError(f"{name}: not a snapshot, or cut short ({len(data)} bytes)")
    _, version, _, seq, time_ns, length = _HEADER.unpack_from(data)
    if _CRC.unpack_from(data, len(data) - _CRC.size)[0] != zlib.crc32(memoryview(data)[: -_CRC.size]):
        raise InputError(f"{name}: damaged (its checksum does not match)")
    if version != FORMAT_VERSION:
        raise InputError(f"{name}: snapshot format {version}; this version reads {FORMAT_VERSION}")
    blob = memoryview(data)[_HEADER.size + length : -_CRC.size]
    document = load_json(data[_HEADER.size : _HEADER.size + length])
    arrays = [_array(item, blob) for item in document["arrays"]]
    return Snapshot(seq, time_ns, _from_plain(document["tree"], arrays))


class _Packer:
    """Turns a tree into JSON and collects its arrays."""

    def __init__(self) -> None:
        self.manifest: list[dict[str, Any]] = []
        self.chunks: list[bytes] = []
        self._offset = 0

    def plain(self, value: Any, path: str) -> Any:
        """``value`` as JSON; ``path`` is where it stands, for the error's text."""
        if isinstance(value, np.ndarray):
            return {"$array": self._add(value, path)}
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, bool | str):
            return value if not isinstance(value, str) else str(value)
        if isinstance(value, int):
            return int(value) if -_INT64 <= value < 2 * _INT64 else {"$int": str(int(value))}
        if isinstance(value, float):
            return float(value) if math.isfinite(value) else {"$float": repr(float(value))}
        if isinstance(value, bytes | bytearray):
            return {"$bytes": base64.b64encode(value).decode("ascii")}
        if isinstance(value, tuple):
            return {"$tuple": [self.plain(item, f"{path}[{index}]") for index, item in enumerate(value)]}
        if isinstance(value, list):
            return [self.plain(item, f"{path}[{index}]") for index, item in enumerate(value)]
        if isinstance(value, dict):
            return self._object(value, path)
        raise InternalError(f"{path} is a {type(value).__name__}: a snapshot cannot hold it")

    def _object(self, value: dict[Any, Any], path: str) -> Any:
        for key in value:
            if not isinstance(key, str):
                raise InternalError(f"{path} has the key {key!r}: a snapshot needs text as keys")
        plain = {str(key): self.plain(item, f"{path}.{key}") for key, item in value.items()}
        return {"$dict": plain} if any(key.startswith("$") for key in plain) else plain

    def _add(self, array: NDArray[Any], path: str) -> int:
        if array.dtype.kind not in _ARRAY_KINDS:
            raise InternalError(f"{path} is an array of {array.dtype}: a snapshot cannot hold it")
        data = np.ascontiguousarray(array).tobytes()
        self.manifest.append({"dtype": array.dtype.str, "shape": list(array.shape), "offset": self._offset})
        padding = -len(data) % _ALIGN
        self.chunks.append(data + bytes(padding))
        self._offset += len(data) + padding
        return len(self.manifest) - 1


def _array(item: dict[str, Any], blob: memoryview) -> NDArray[Any]:
    dtype = np.dtype(item["dtype"])
    count = math.prod(item["shape"])
    if count * dtype.itemsize == 0:
        return np.zeros(item["shape"], dtype)
    flat: NDArray[Any] = np.frombuffer(blob, dtype, count, item["offset"])
    return flat.reshape(item["shape"]).copy()


def _from_plain(plain: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(plain, list):
        return [_from_plain(item, arrays) for item in plain]
    if not isinstance(plain, dict):
        return plain
    key, value = next(iter(plain.items())) if len(plain) == 1 else ("", None)
    if key.startswith("$"):
        return _SPECIAL[key](value, arrays)
    return {name: _from_plain(item, arrays) for name, item in plain.items()}


_SPECIAL: dict[str, Callable[[Any, list[NDArray[Any]]], Any]] = {
    "$array": lambda value, arrays: arrays[value],
    "$int": lambda value, arrays: int(value),
    "$float": lambda value, arrays: float(value),
    "$bytes": lambda value, arrays: base64.b64decode(value),
    "$tuple": lambda value, arrays: tuple(_from_plain(item, arrays) for item in value),
    "$dict": lambda value, arrays: {name: _from_plain(item, arrays) for name, item in value.items()},
}
