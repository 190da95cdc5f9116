"""What may be set about the session's files."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StoreSettings:
    """How much a crash may cost, and how much disk and memory the files may take."""

    flush_interval_s: float = 0.2
    """Longest time that a frame waits in memory before it is given to the operating system, seconds.
    What a killed process loses; at most 0.5. Operators' actions do not wait."""
    fsync_interval_s: float = 5.0
    """Time between the calls that put the files on the disk itself, seconds. What a power cut loses."""
    segment_bytes: int = 64_000_000
    """Size at which the journal goes on in a new file, bytes."""
    pending_bytes: int = 16_000_000
    """How much may wait in memory while the disk is full, bytes a file; what comes beyond it is dropped
    and counted."""
    retry_interval_s: float = 5.0
    """Time between attempts to write again after the disk refused, seconds."""
    snapshot_interval_s: float = 30.0
    """Time between snapshots of the engines' state, seconds: bounds how long a restart takes."""
    snapshot_keep: int = 3
    """How many snapshots are kept; older ones are deleted."""
    database_queue: int = 10_000
    """Rows that may wait for the database's writer; beyond it rows are dropped, counted."""
    resume_max_age_h: float = 12.0
    """A session that stopped longer ago is not taken up again by itself, hours."""
