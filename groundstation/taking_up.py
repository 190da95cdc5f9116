"""A session goes on after a stop: its engines are brought to where its journal ends.

Rule: the same records in the same order as before the stop, without the windows that a full queue
cost then; a session that was stopped anywhere continues as its replay does. What is taken up is
shown, not told again as news, and nothing of it leaves: frames of the past are let fall.
"""

from __future__ import annotations

import asyncio

from groundstation.display import Display
from groundstation.lanes import EstimatorLane
from groundstation.pipeline import Pipeline, dropped_windows, without_dropped
from groundstation.store.session import ResumedSession

_DRAIN_EVERY = 2000
_DRAIN_S = 60.0


async def take_up(resumed: ResumedSession, pipeline: Pipeline, lane: EstimatorLane, display: Display) -> None:
    """Start the lane, restore the snapshot and handle what was journalled behind it.

    The record that says ``resumed`` and the events of taking up are left to the caller.
    """
    state = resumed.snapshot.state if resumed.snapshot is not None else None
    await asyncio.to_thread(lane.start, state["estimator"] if state is not None else None)
    if state is not None:
        pipeline.restore(state["pipeline"], pipeline.mission)
        pipeline.mission = pipeline.desk.mission
        display.hub.apply(pipeline.mission)
    display.taking_up = True
    tail = await asyncio.to_thread(list, resumed.tail)
    dropped = dropped_windows(tail)
    for number, record in enumerate(tail):
        step = pipeline.handle(record)
        lane.submit(tuple(without_dropped(step.work, dropped)))
        display.step(record, step)
        if number % _DRAIN_EVERY == _DRAIN_EVERY - 1:
            await asyncio.to_thread(lane.drain, _DRAIN_S)
    await asyncio.to_thread(lane.drain, _DRAIN_S)
    await asyncio.sleep(0)  # what the lane handed over runs now
    display.taking_up = False
