"""What the page asks a live session for: from its database, its disk and its exporters."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.domain.events import Event, Severity
from groundstation.domain.geometry import Geodetic
from groundstation.domain.target import Environment, TargetState
from groundstation.page_sources import session_sources
from groundstation.store.session import Session, open_new


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    session, _ = open_new(tmp_path, "0.1")
    yield session
    session.abandon()


async def test_events_and_beliefs_of_the_database_are_given_oldest_first(session: Session) -> None:
    events = [Event(n, "a", Severity.INFO, f"event {n}") for n in (1, 2, 3)]
    place = Geodetic(-35.3625, 149.1654, 584.25)
    for event in events:
        session.database.store(event)
    for n in (1, 2):
        session.database.store(
            TargetState(
                beacon_id=7,
                time_ns=n * 10**9,
                first_heard_ns=0,
                last_heard_ns=n,
                position=place,
                covariance_enu_m2=(9.0, 0.0, 0.0, 4.0, 0.0, 1.0),
                radius_90_m=8.5 * n,
                environment=Environment.LOS,
                los_links=4,
                links=4,
                windows=10 * n,
                method="posterior",
                height_reference="home",
                sequence=n,
                snapshot=None,
            )
        )
    session.database.flush()
    sources = session_sources(session)
    assert sources.older_events is not None
    assert list(await sources.older_events(3, 10)) == events[:2]
    assert sources.history is not None
    points = await sources.history(7, 0, 50)
    assert [(point.time_ns, point.radius_90_m, point.windows) for point in points] == [
        ("1000000000", 8.5, 10),
        ("2000000000", 17.0, 20),
    ]
    assert (points[0].latitude_deg, points[0].altitude_amsl_m, points[0].links) == (-35.3625, 584.25, 4)
    assert await sources.history(7, 2 * 10**9, 50) == []


def test_a_disk_that_fails_is_a_failed_check(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = session_sources(session)
    assert sources.health is not None
    assert sources.health() == []
    monkeypatch.setattr(session, "health", lambda: {"journal": "no space left on device"})
    (check,) = sources.health()
    assert (check.name, check.ok, check.detail) == ("journal", False, "no space left on device")
