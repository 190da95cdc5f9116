"""What the station keeps on disk: journal, snapshots, database, recording, one folder a session.

Rule: once a session is open, nothing on this machine's disk can stop the station. A full or
broken disk is a health state and an event, never an exception into the event loop; a damaged
file is read as far as it goes, and what was lost is counted.
"""

from groundstation.store.clock import StationClock
from groundstation.store.database import Database
from groundstation.store.journal import Journal, JournalReader
from groundstation.store.session import (
    ResumedSession,
    Session,
    find_resumable,
    open_new,
    open_to_read,
    resume,
)
from groundstation.store.settings import StoreSettings
from groundstation.store.snapshots import Snapshot, SnapshotStore, load_snapshot, save_snapshot

__all__ = [
    "Database",
    "Journal",
    "JournalReader",
    "ResumedSession",
    "Session",
    "Snapshot",
    "SnapshotStore",
    "StationClock",
    "StoreSettings",
    "find_resumable",
    "load_snapshot",
    "open_new",
    "open_to_read",
    "resume",
    "save_snapshot",
]
