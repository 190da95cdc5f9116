"""Planning beside the event loop: what is taken, what is news, and what a failure costs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Iterator

import pytest

from groundstation.domain.errors import InputError
from groundstation.domain.events import Event
from groundstation.domain.inputs import PlanInput
from groundstation.domain.mission import Mission
from groundstation.guidance.plan import PlanRequest
from groundstation.planning_lane import PlanningLane

REQUEST = PlanRequest(7, Mission(revision=2), (), ())


class Station:
    """Asks as often as there are answers, then ends the lane."""

    def __init__(self, answers: list[PlanInput | Exception | None]) -> None:
        self.answers: Iterator[PlanInput | Exception | None] = iter(answers)
        self.next: PlanInput | Exception | None = None
        self.taken: list[PlanInput] = []
        self.told: list[Event] = []

    def request(self) -> PlanRequest | None:
        try:
            self.next = next(self.answers)
        except StopIteration:
            raise asyncio.CancelledError from None
        return None if self.next is None else REQUEST

    def propose(self, request: PlanRequest) -> PlanInput:
        assert request is REQUEST
        if isinstance(self.next, Exception):
            raise self.next
        assert self.next is not None
        return self.next

    async def run(self) -> Station:
        lane = PlanningLane(self.request, self.propose, self.taken.append, self.told.append, interval_s=0.0)
        with contextlib.suppress(asyncio.CancelledError):
            await lane.run()
        return self


def plan(*notes: str) -> PlanInput:
    return PlanInput(2, (), notes)


async def test_a_note_that_differs_in_its_numbers_only_is_told_once() -> None:
    said = [plan("not heard for 34 s"), plan("not heard for 39.5 s"), plan("not heard for 40 s", "too low")]
    station = await Station(list(said)).run()
    assert station.taken == [said[0], said[2]]
    assert [(event.time_ns, event.code, event.text) for event in station.told] == [
        (7, "plan.note", "not heard for 34 s"),
        (7, "plan.note", "too low"),
    ]


async def test_a_note_that_comes_back_is_news_again() -> None:
    station = await Station([plan("too low"), plan(), plan("too low")]).run()
    assert len(station.taken) == 3
    assert [event.text for event in station.told] == ["too low", "too low"]


async def test_nothing_to_plan_for_asks_nobody_and_a_failure_is_a_line_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        station = await Station([None, InputError("the area is empty"), plan("too low")]).run()
    assert station.taken == [plan("too low")]
    assert "the area is empty" in caplog.text
