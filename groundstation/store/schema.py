"""The database's tables, and how an older file becomes a newer one.

Rule: a migration is appended, never edited; ``PRAGMA user_version`` says how many have run.
Every insert may come twice (a restart replays the journal's tail), so every table has a
unique key by which the second is ignored. Beacon ids pass SQLite's signed 64 bits and are
decimal text; times are station time in nanoseconds since the Unix epoch.
"""

from __future__ import annotations

import sqlite3

from groundstation.domain.errors import InputError

APPLICATION_ID = 0x47535331
"""``GSS1``: what ``file`` and the station know the database by."""

MIGRATIONS: tuple[str, ...] = (
    """
    CREATE TABLE events (
        id INTEGER PRIMARY KEY,
        time_ns INTEGER NOT NULL,
        code TEXT NOT NULL,
        severity TEXT NOT NULL,
        text TEXT NOT NULL,
        vehicle_id INTEGER,
        beacon_id TEXT
    );
    CREATE UNIQUE INDEX events_once
        ON events (time_ns, code, text, ifnull(vehicle_id, -1), ifnull(beacon_id, ''));

    CREATE TABLE targets (
        id INTEGER PRIMARY KEY,
        beacon_id TEXT NOT NULL,
        sequence INTEGER NOT NULL,
        time_ns INTEGER NOT NULL,
        first_heard_ns INTEGER NOT NULL,
        last_heard_ns INTEGER NOT NULL,
        latitude_deg REAL NOT NULL,
        longitude_deg REAL NOT NULL,
        altitude_amsl_m REAL NOT NULL,
        covariance_ee_m2 REAL, covariance_en_m2 REAL, covariance_eu_m2 REAL,
        covariance_nn_m2 REAL, covariance_nu_m2 REAL, covariance_uu_m2 REAL,
        radius_90_m REAL,
        environment TEXT NOT NULL,
        los_links INTEGER NOT NULL,
        links INTEGER NOT NULL,
        windows INTEGER NOT NULL,
        method TEXT NOT NULL,
        height_reference TEXT NOT NULL
    );
    CREATE UNIQUE INDEX targets_once ON targets (beacon_id, time_ns, sequence);

    CREATE TABLE commands (
        id INTEGER PRIMARY KEY,
        command_id TEXT NOT NULL,
        vehicle_id INTEGER NOT NULL,
        kind TEXT NOT NULL,
        phase TEXT NOT NULL,
        time_ns INTEGER NOT NULL,
        detail TEXT NOT NULL,
        latitude_deg REAL, longitude_deg REAL, altitude_amsl_m REAL,
        proposal_id TEXT,
        attempts INTEGER NOT NULL
    );
    CREATE UNIQUE INDEX commands_once ON commands (command_id, time_ns, phase, attempts, detail);

    CREATE TABLE operator_actions (
        seq INTEGER PRIMARY KEY,
        time_ns INTEGER NOT NULL,
        who TEXT NOT NULL,
        decision TEXT NOT NULL,
        proposal_id TEXT,
        vehicle_id INTEGER
    );

    CREATE TABLE link_minutes (
        vehicle_id INTEGER NOT NULL,
        beacon_id TEXT NOT NULL,
        minute_ns INTEGER NOT NULL,
        last_ns INTEGER NOT NULL,
        windows INTEGER NOT NULL,
        captures INTEGER NOT NULL,
        los_probability_sum REAL NOT NULL,
        los_probability_last REAL NOT NULL,
        los_probability_min REAL NOT NULL,
        los_probability_max REAL NOT NULL,
        source TEXT NOT NULL,
        rss_dbm_last REAL,
        PRIMARY KEY (vehicle_id, beacon_id, minute_ns)
    ) WITHOUT ROWID;
    """,
)


def migrate(connection: sqlite3.Connection, name: str) -> None:
    """Bring an open database to the newest schema, in one transaction.

    Raises:
        InputError: another program's database, or one of a newer version.
        sqlite3.DatabaseError: damaged, or the disk refuses.
    """
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    if version > len(MIGRATIONS):
        raise InputError(f"{name}: database schema {version}; this version knows up to {len(MIGRATIONS)}")
    if application not in (0, APPLICATION_ID) or (version > 0 and application != APPLICATION_ID):
        raise InputError(f"{name}: a database of another program (application id {application:#x})")
    for number in range(version, len(MIGRATIONS)):
        connection.executescript(
            f"BEGIN IMMEDIATE; {MIGRATIONS[number]}; PRAGMA application_id = {APPLICATION_ID}; "
            f"PRAGMA user_version = {number + 1}; COMMIT;"
        )
