"""meta.json and the lock."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from groundstation.domain.errors import InputError, ResourceError
from groundstation.store.meta import Lock, SessionMeta, read_meta, write_meta


def test_round_trip(tmp_path: Path) -> None:
    meta = SessionMeta.new("2026-11-22T014500Z", "0.1", 5, {"server": {"http_port": 8000}})
    meta = meta.resumed("0.2", 6, {}).ended(7)
    write_meta(tmp_path, meta)
    assert read_meta(tmp_path) == meta
    assert meta.formats == {"journal": 1, "snapshot": 1, "database": 1}
    assert meta.resumed("0.3", 8, {}).ended_unix_us is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "not a session's metadata"),
        ('{"format": "other"}', "not a session's metadata"),
        (
            '{"format": "groundstation-session", "format_version": 9}',
            "session format 9",
        ),
        ('{"format": "groundstation-session", "format_version": 1}', "missing or unknown"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=r"it has no meta\.json"):
        read_meta(tmp_path)
    (tmp_path / "meta.json").write_text(text)
    with pytest.raises(InputError, match=message):
        read_meta(tmp_path)


def test_lock_is_exclusive_and_names_its_owner(tmp_path: Path) -> None:
    assert not Lock.is_taken(tmp_path)
    lock = Lock.take(tmp_path)
    assert Lock.is_taken(tmp_path)
    with pytest.raises(ResourceError, match=rf"in use by another station \(process {os.getpid()}\)"):
        Lock.take(tmp_path)
    lock.release()
    lock.release()
    assert not Lock.is_taken(tmp_path)
    Lock.take(tmp_path).release()
