"""``meta.json`` of a session, and the lock that keeps two stations out of one directory.

Rule: the file is written whole or not at all, and names the version of every format beside
it, so that a later program can say what it cannot read.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import orjson

from groundstation.domain.errors import InputError, ResourceError
from groundstation.store import journal, schema, snapshots

FORMAT = "groundstation-session"
FORMAT_VERSION = 1
_NAME = "meta.json"


@dataclass(frozen=True, slots=True)
class SessionMeta:
    """What made a session."""

    format: str
    """``groundstation-session``."""
    format_version: int
    session_id: str
    """The directory's name when it was made."""
    version: str
    """Of the program that began it."""
    formats: dict[str, int]
    """Version of the journal, the snapshots and the database."""
    runs: tuple[dict[str, Any], ...]
    """One for each start: ``version``, ``unix_us`` (wall clock), ``config`` (settings in force)."""
    ended_unix_us: int | None
    """Wall clock of the clean end; None: running, or stopped short."""

    @classmethod
    def new(cls, session_id: str, version: str, unix_us: int, config: dict[str, Any]) -> SessionMeta:
        """Of a session that begins now."""
        formats = {
            "journal": journal.FORMAT_VERSION,
            "snapshot": snapshots.FORMAT_VERSION,
            "database": len(schema.MIGRATIONS),
        }
        run = {"version": version, "unix_us": unix_us, "config": config}
        return cls(FORMAT, FORMAT_VERSION, session_id, version, formats, (run,), None)

    def resumed(self, version: str, unix_us: int, config: dict[str, Any]) -> SessionMeta:
        """With one more run; not ended."""
        run = {"version": version, "unix_us": unix_us, "config": config}
        return replace(self, runs=(*self.runs, run), ended_unix_us=None)

    def ended(self, unix_us: int) -> SessionMeta:
        """Ended cleanly."""
        return replace(self, ended_unix_us=unix_us)


def write_meta(directory: Path, meta: SessionMeta) -> None:
    """Write it. Raises ResourceError."""
    data = orjson.dumps(asdict(meta), option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS, default=str)
    snapshots.write_atomically(directory / _NAME, data + b"\n")


def read_meta(directory: Path) -> SessionMeta:
    """Read it.

    Raises:
        InputError: not a session's directory, or of a newer format.
    """
    path = directory / _NAME
    try:
        data = orjson.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError(f"{directory}: not a session's directory (it has no {_NAME})") from error
    except OSError as error:
        raise ResourceError(f"cannot read {path}: {error.strerror}") from error
    except orjson.JSONDecodeError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise InputError(f"{path}: not a session's metadata (format {FORMAT!r} is needed)")
    if data.get("format_version") != FORMAT_VERSION:
        raise InputError(
            f"{path}: session format {data.get('format_version')}; this version reads {FORMAT_VERSION}"
        )
    try:
        return SessionMeta(**{**data, "runs": tuple(data["runs"])})
    except (TypeError, KeyError) as error:
        raise InputError(f"{path}: fields are missing or unknown: {error}") from error


class Lock:
    """An exclusive lock on a session's directory; the kernel drops it with the process."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor: int | None = descriptor

    @classmethod
    def take(cls, directory: Path) -> Lock:
        """Take it. Raises ResourceError when another station has it."""
        path = directory / "lock"
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise ResourceError(f"cannot open {path}: {error.strerror}") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip()
            os.close(descriptor)
            raise ResourceError(
                f"{directory} is in use by another station (process {owner or 'unknown'}); end that one first"
            ) from error
        os.ftruncate(descriptor, 0)
        # A full disk: the lock holds all the same, only its owner is not named.
        with contextlib.suppress(OSError):
            os.pwrite(descriptor, str(os.getpid()).encode(), 0)
        return cls(descriptor)

    @staticmethod
    def is_taken(directory: Path) -> bool:
        """Whether a station has the directory open now."""
        try:
            descriptor = os.open(directory / "lock", os.O_RDWR | os.O_CLOEXEC)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False

    def release(self) -> None:
        """Let go; a second call does nothing."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
