"""The schema: made once, refused when newer or another program's."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator

import pytest

from groundstation.domain.errors import InputError
from groundstation.store import schema


@pytest.fixture
def connection() -> Iterator[sqlite3.Connection]:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    yield connection
    connection.close()


def test_migrates_once(connection: sqlite3.Connection) -> None:
    schema.migrate(connection, "x")
    schema.migrate(connection, "x")
    assert connection.execute("PRAGMA user_version").fetchone() == (len(schema.MIGRATIONS),)
    names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    assert {"events", "targets", "commands", "operator_actions", "link_minutes"} <= names


def test_an_older_database_gets_what_is_new(
    connection: sqlite3.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    schema.migrate(connection, "x")
    connection.execute("INSERT INTO events VALUES (1, 2, 'a', 'info', 'text', NULL, NULL)")
    newer = (*schema.MIGRATIONS, "ALTER TABLE events ADD COLUMN station TEXT")
    monkeypatch.setattr(schema, "MIGRATIONS", newer)
    schema.migrate(connection, "x")
    assert connection.execute("SELECT id, station FROM events").fetchall() == [(1, None)]


def test_refuses_a_newer_one_and_another_programs(connection: sqlite3.Connection) -> None:
    connection.execute("PRAGMA user_version = 99")
    with pytest.raises(InputError, match="schema 99"):
        schema.migrate(connection, "x")
    connection.execute("PRAGMA user_version = 0")
    connection.execute("PRAGMA application_id = 5")
    with pytest.raises(InputError, match="another program"):
        schema.migrate(connection, "x")
