"""Planning, a lane of its own: where vehicles should fly next, asked for every few seconds.

Exists because planning takes longer than the event loop may wait, and its answer may come late.
Rule: a plan is an input like any other, with what it was based on; whoever takes it judges it
again. A note that says the same as the last one's is no news.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable

from groundstation.domain.errors import GroundstationError
from groundstation.domain.events import Event, Severity
from groundstation.domain.inputs import PlanInput
from groundstation.guidance.plan import PlanRequest

logger = logging.getLogger(__name__)

PLAN_INTERVAL_S = 5.0
_NUMBER = re.compile(r"\d+(\.\d+)?")


class PlanningLane:
    """Asks, plans on a thread, hands the answer over; ``run`` until cancelled."""

    def __init__(
        self,
        request: Callable[[], PlanRequest | None],
        propose: Callable[[PlanRequest], PlanInput],
        take: Callable[[PlanInput], object],
        tell: Callable[[Event], None],
        *,
        interval_s: float = PLAN_INTERVAL_S,
    ) -> None:
        """``request`` says what to plan for, None for nothing; ``propose`` runs on a thread, all else in
        the event loop.
        """
        self._request = request
        self._propose = propose
        self._take = take
        self._tell = tell
        self._interval_s = interval_s
        self._notes: frozenset[str] = frozenset()

    async def run(self) -> None:
        """Plan again and again; a planner that fails is a line in the log."""
        while True:
            await asyncio.sleep(self._interval_s)
            request = self._request()
            if request is None:
                continue
            try:
                plan = await asyncio.to_thread(self._propose, request)
            except GroundstationError as error:
                logger.warning("planning: %s", error)
                continue
            # "not heard for 34 s" and "… for 39 s" are the same news.
            news = {_NUMBER.sub("#", note): note for note in plan.notes}
            if plan.proposals or news.keys() != self._notes:
                self._take(plan)
                for gist, note in news.items():
                    if gist not in self._notes:
                        self._tell(Event(request.time_ns, "plan.note", Severity.INFO, note))
                self._notes = frozenset(news)
