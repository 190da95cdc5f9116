"""A merged delta leaves a page where both in turn would: checked against a model of a page."""

from __future__ import annotations

from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.domain.command import ProposalGone
from groundstation.domain.target import TargetWaiting
from groundstation.server import wire
from groundstation.server.merge import merge
from groundstation.server.picture import Picture
from groundstation.server.settings import ServerSettings

_steps = st.lists(
    st.tuples(
        st.sampled_from(
            ["vehicle", "proposal", "gone", "link", "event", "regions", "explanation", "waiting"]
        ),
        st.integers(1, 4),
    ),
    max_size=12,
)


class _Page:
    def __init__(self) -> None:
        self.tables: dict[str, dict[str, wire.Model]] = {
            "vehicle": {},
            "proposal": {},
            "link": {},
            "target": {},
            "regions": {},
            "explanation": {},
        }
        self.events: list[int] = []

    def apply(self, delta: wire.Delta) -> None:
        for gone in delta.removed:
            self.tables[gone.kind].pop(gone.key, None)
        for vehicle in delta.rows.vehicles:
            self.tables["vehicle"][str(vehicle.vehicle_id)] = vehicle
        for proposal in delta.rows.proposals:
            self.tables["proposal"][proposal.proposal_id] = proposal
        for link in delta.rows.links:
            self.tables["link"][f"{link.vehicle_id}:{link.beacon_id}"] = link
        for target in delta.rows.targets:
            self.tables["target"][target.beacon_id] = target
        for regions in delta.rows.regions:
            self.tables["regions"][regions.beacon_id] = regions
        for told in delta.rows.explanations:
            self.tables["explanation"][told.beacon_id] = told
        self.events.extend(event.number for event in delta.events)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(first=_steps, second=_steps, third=_steps)
def test_merged_is_the_same_as_in_turn(make: Any, first: Any, second: Any, third: Any) -> None:
    picture = Picture("e", ServerSettings(max_links=3, max_targets=3))
    count = 0
    deltas = []
    for steps in (first, second, third):
        for what, number in steps:
            count += 1
            match what:
                case "vehicle":
                    picture.apply(make.vehicle(number, mode=str(count)))
                case "proposal":
                    picture.apply(make.proposal(f"p-{number}"))
                case "gone":
                    picture.apply(ProposalGone(f"p-{number}", count, "expired"))
                case "link":
                    picture.apply(make.activity(number, 7, count))
                case "regions":
                    picture.apply(make.target(number, regions=make.regions(north_deg=count * 1e-5)))
                case "explanation":
                    picture.apply(make.target(number))
                    picture.apply(make.explanation(number, weight=count * 1e-3))
                case "waiting":
                    picture.apply(TargetWaiting(number, count, 1, 1, "more"))
                case _:
                    picture.apply(make.event(str(count)))
        delta = picture.take_delta(0)
        if delta is not None:
            deltas.append(delta)
    in_turn, at_once = _Page(), _Page()
    for delta in deltas:
        in_turn.apply(delta)
    if deltas:
        merged = deltas[0]
        for delta in deltas[1:]:
            merged = merge(merged, delta)
        at_once.apply(merged)
        assert (merged.previous_seq, merged.seq) == (0, picture.seq)
    assert at_once.tables == in_turn.tables
    assert at_once.events == in_turn.events
    shown = {row.proposal_id for row in picture.proposals.rows()}
    assert set(at_once.tables["proposal"]) == shown
    assert set(at_once.tables["regions"]) == {row.beacon_id for row in picture.regions.rows()}
    assert set(at_once.tables["regions"]) <= set(at_once.tables["target"])
    assert len(at_once.tables["link"]) == len(picture.links)
