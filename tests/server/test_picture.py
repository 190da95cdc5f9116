"""The picture: coalescing, numbering, resuming, bounds."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.domain.command import CommandKind, CommandPhase, CommandStatus, ProposalGone
from groundstation.domain.errors import InternalError
from groundstation.domain.events import Counter
from groundstation.domain.geometry import Geodetic
from groundstation.domain.inputs import ConnectionInput, MissionInput
from groundstation.domain.mission import Area, Mission
from groundstation.domain.target import LinkVerdict, LosSource, TargetWaiting
from groundstation.server.picture import Picture
from groundstation.server.rows import ForwardStatus, StationStatus
from groundstation.server.settings import ServerSettings


def test_nothing_new_is_no_delta(make: Any) -> None:
    picture = Picture("e")
    assert picture.take_delta(1) is None
    picture.apply(make.vehicle())
    first = picture.take_delta(1)
    assert first is not None
    assert (first.seq, first.previous_seq) == (1, 0)
    assert picture.take_delta(2) is None
    assert picture.seq == 1


def test_state_is_coalesced_and_events_are_not(make: Any) -> None:
    picture = Picture("e")
    for number in range(50):
        picture.apply(make.vehicle(1, mode=f"M{number}"))
        picture.apply(make.event(f"event {number}"))
    delta = picture.take_delta(1)
    assert delta is not None
    assert [row.mode for row in delta.rows.vehicles] == ["M49"]
    assert [row.text for row in delta.events] == [f"event {number}" for number in range(50)]
    assert [row.number for row in delta.events] == list(range(1, 51))


def test_a_link_is_made_of_its_activity_and_its_verdict(make: Any) -> None:
    picture = Picture("e")
    picture.apply(make.activity(time_ns=10))
    picture.apply(LinkVerdict(1, 7, 20, 0.9, LosSource.CLASSIFIER, "", -72.0, 0.1, 0.2, 5))
    picture.apply(make.activity(time_ns=30))
    (row,) = picture.link_rows()
    assert (row.last_heard_ns, row.verdict_time_ns, row.rss_dbm) == ("30", "20", -70.0)
    assert (row.los_probability, row.los_source, row.samples_total) == (0.9, "classifier", 12)


def test_every_output_has_its_place(make: Any) -> None:
    picture = Picture("e")
    ring = ((1.0, 2.0), (1.0, 3.0), (2.0, 3.0), (1.0, 2.0))
    mission = Mission(revision=2, origin=make.place, fence=Area(((ring,),), "fence"))
    outputs = [
        make.vehicle(),
        make.activity(),
        make.target(regions=make.regions()),
        TargetWaiting(8, 5, 4, 1, "2 more vehicles must hear it"),
        make.proposal(),
        CommandStatus("c", 1, CommandKind.HOLD, CommandPhase.HOLDING, 6, "", None, None, 1),
        make.event(),
        Counter("frames_total", (("connection", "a"),), 3),
        ConnectionInput("a", "open", ""),
        MissionInput(mission, "me"),
        ForwardStatus("udpout:1.2.3.4:5", True, True),
        StationStatus("1", "t", "live", True, ""),
    ]
    for output in outputs:
        picture.apply(output, 7)
    delta = picture.take_delta(9)
    assert delta is not None
    rows = delta.rows
    sizes = [
        len(part)
        for part in (rows.vehicles, rows.links, rows.targets, rows.regions, rows.proposals, rows.commands,
                     rows.connections, rows.counters, rows.forwards or [])
    ]  # fmt: skip
    assert sizes == [1, 1, 2, 1, 1, 1, 1, 1, 1]
    assert rows.station is not None
    assert rows.mission is not None
    assert rows.mission.fence is not None
    # Domain rings are (latitude, longitude), GeoJSON wants the other order.
    assert rows.mission.fence.polygons_deg[0][0][0] == [2.0, 1.0]
    snapshot = picture.snapshot(10)
    assert snapshot.rows.model_dump() == rows.model_dump()
    assert (snapshot.seq, snapshot.events, len(snapshot.trails)) == (1, delta.events, 1)


def test_what_is_not_for_the_picture_is_refused() -> None:
    with pytest.raises(InternalError, match="no place for a str"):
        Picture("e").apply("nonsense")  # type: ignore[arg-type]


def test_a_proposal_that_is_gone_says_why_even_if_it_was_never_shown(make: Any) -> None:
    picture = Picture("e")
    picture.apply(make.proposal())
    picture.apply(ProposalGone("p-1", 5, "expired"))
    delta = picture.take_delta(1)
    assert delta is not None
    assert delta.rows.proposals == []
    assert [(gone.kind, gone.key, gone.reason) for gone in delta.removed] == [("proposal", "p-1", "expired")]


def test_resuming_gives_what_was_missed_in_one_delta(make: Any) -> None:
    picture = Picture("e")
    for number in range(5):
        picture.apply(make.vehicle(1, mode=f"M{number}"))
        picture.apply(make.event(f"event {number}"))
        picture.take_delta(number)
    assert picture.since("e", 5) == []
    missed = picture.since("e", 2)
    assert missed is not None
    (delta,) = missed
    assert (delta.previous_seq, delta.seq) == (2, 5)
    assert [row.mode for row in delta.rows.vehicles] == ["M4"]
    assert [row.text for row in delta.events] == ["event 2", "event 3", "event 4"]


@pytest.mark.parametrize(("epoch", "seq"), [("other", 5), ("e", 6), ("e", -1), ("e", 0)])
def test_what_cannot_be_resumed_gets_a_snapshot(make: Any, epoch: str, seq: int) -> None:
    picture = Picture("e", ServerSettings(ring_deltas=3))
    for number in range(5):
        picture.apply(make.event(str(number)))
        picture.take_delta(number)
    assert picture.since(epoch, seq) is None
    assert picture.since("e", 2) is not None


def test_every_table_is_bounded_and_what_gives_way_is_counted(make: Any) -> None:
    picture = Picture(
        "e",
        ServerSettings(max_links=2, max_counters=1, events_in_memory=2, trail_points=2, snapshot_events=1),
    )
    for beacon_id in (1, 2, 3):
        picture.apply(make.activity(1, beacon_id))
    assert [row.beacon_id for row in picture.link_rows()] == ["2", "3"]
    assert picture.links.evicted_total == 1
    delta = picture.take_delta(0)
    assert delta is not None
    assert [gone.key for gone in delta.removed] == ["1:1"]
    for name in ("a_total", "b_total"):
        picture.apply(Counter(name, (), 1))
    assert picture.counters_refused_total == 1
    for number in range(4):
        picture.apply(make.event(str(number)))
        north = Geodetic(-35.0 + number * 1e-3, 149.0, 600.0)
        picture.apply(make.vehicle(position=north))
    assert [row.text for row in picture.events] == ["2", "3"]
    unsent = picture.take_delta(0)
    assert unsent is not None
    assert [row.number for row in unsent.events] == [3, 4]
    assert picture.events_unsent_total == 2
    snapshot = picture.snapshot(0)
    assert len(snapshot.events) == 1
    assert len(snapshot.trails[0].points_deg) == 2


def test_a_counter_that_did_not_change_is_not_sent_again() -> None:
    picture = Picture("e")
    picture.apply(Counter("a_total", (), 1))
    assert picture.take_delta(0) is not None
    picture.apply(Counter("a_total", (), 1))
    assert picture.take_delta(0) is None


def test_regions_go_out_when_they_change_and_are_kept_in_between(make: Any) -> None:
    picture = Picture("e")
    drawn = make.regions()
    picture.apply(make.target(7, regions=drawn, time_ns=10))
    first = picture.take_delta(1)
    assert first is not None
    (row,) = first.rows.regions
    assert (row.beacon_id, row.time_ns) == ("7", "10")
    assert [region.share for region in row.regions] == [0.5, 0.9, 0.95]
    # Updates without regions, and one with the very same, send none and lose none.
    for update in (make.target(7, time_ns=11), make.target(7, regions=drawn, time_ns=12)):
        picture.apply(update)
        delta = picture.take_delta(2)
        assert delta is not None
        assert (len(delta.rows.targets), delta.rows.regions) == (1, [])
    assert picture.snapshot(3).rows.regions == [row]
    picture.apply(make.target(7, regions=make.regions(north_deg=1e-4), time_ns=13))
    moved = picture.take_delta(4)
    assert moved is not None
    assert [row.time_ns for row in moved.rows.regions] == ["13"]


def test_regions_go_with_the_estimate_and_with_the_beacon(make: Any) -> None:
    picture = Picture("e", ServerSettings(max_targets=2))
    picture.apply(make.target(7, regions=make.regions()))
    picture.apply(make.target(8, regions=make.regions()))
    picture.take_delta(1)
    picture.apply(TargetWaiting(8, 5, 4, 1, "2 more vehicles must hear it"))
    picture.apply(make.target(9, regions=make.regions()))
    delta = picture.take_delta(2)
    assert delta is not None
    assert {(gone.kind, gone.key) for gone in delta.removed} == {
        ("target", "7"), ("regions", "7"), ("regions", "8"),
    }  # fmt: skip
    assert [row.beacon_id for row in picture.snapshot(3).rows.regions] == ["9"]


def test_a_delta_of_a_whole_search_stays_small(make: Any) -> None:
    # 20 vehicles and 5 beacons: everything changed, and each beacon's regions once in two seconds.
    picture = Picture("e")

    def everything(time_ns: int, **regions: Any) -> int:
        for vehicle_id in range(1, 21):
            picture.apply(make.vehicle(vehicle_id, time_ns=time_ns))
            for beacon_id in range(1, 6):
                picture.apply(make.activity(vehicle_id, beacon_id, time_ns))
        for beacon_id in range(1, 6):
            picture.apply(make.target(beacon_id, time_ns=time_ns, **regions))
        delta = picture.take_delta(time_ns)
        assert delta is not None
        return len(delta.model_dump_json())

    without = everything(1)
    drawn = everything(2, regions=make.regions(corners=60))
    after = everything(3)
    assert after == without < 64_000
    assert drawn - without < 5 * 6_000
