"""The estimator's lane: one spawned process that takes its inputs in order.

Solving may take tens of milliseconds; the event loop must answer "hold all" in one. So the
estimator lives in a process of its own, fed over a pipe by one thread. Overload is decided
here, at a bounded queue: the oldest windows are dropped, and what was dropped is handed
back to be journalled, because a replay must drop the same.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from groundstation.channel import load_classifier
from groundstation.domain.events import Counter
from groundstation.domain.radio import LinkWindow
from groundstation.engine.estimator import Estimator, EstimatorOutput
from groundstation.engine.estimator_settings import EstimatorSettings
from groundstation.pipeline import Work

WindowKey = tuple[int, int, int]


def estimator_process(
    settings: EstimatorSettings, state: dict[str, Any] | None, pipe: Connection
) -> None:  # pragma: no cover - runs in the child
    """Body of the child: batches of work in, lists of outputs back, until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when we end
    with contextlib.suppress(OSError):
        os.nice(5)  # the event loop goes first
    estimator = Estimator(settings, load_classifier())
    if state is not None:
        estimator.restore(state)
    while True:
        try:
            question, body = pipe.recv()
        except EOFError:
            return
        if question == "work":
            outputs: list[EstimatorOutput] = []
            for work in body:
                outputs.extend(estimator.handle(work.time_ns, work.item))
            pipe.send((outputs, estimator.counters()))
        elif question == "state":
            pipe.send(estimator.state())
        else:
            return


class EstimatorLane:
    """The child process and the thread that talks to it.

    ``on_outputs(outputs, counters)`` and ``on_failure(text, dropped)`` are called from the
    lane's thread; the station hands them to its event loop.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        on_outputs: Callable[[list[EstimatorOutput], list[Counter]], None],
        on_failure: Callable[[str, tuple[WindowKey, ...]], None],
        *,
        queue_windows: int = 4096,
    ) -> None:
        self._settings = settings
        self._on_outputs = on_outputs
        self._on_failure = on_failure
        self._limit = queue_windows
        self._pending: deque[Work | Callable[[dict[str, Any]], None]] = deque()
        self._windows_pending = 0
        self._condition = threading.Condition()
        self._closing = False
        self._busy = False
        # What the child was given since the state below: a child that dies is brought back exactly.
        self._base_state: dict[str, Any] | None = None
        self._since_base: list[Work] = []
        self._context = multiprocessing.get_context("spawn")
        self._process: Any = None
        self._pipe: Connection | None = None
        self._thread = threading.Thread(target=self._run, name="estimator-lane", daemon=True)

    def start(self, state: dict[str, Any] | None = None) -> None:
        """Spawn the child with a restored state, or a fresh one."""
        self._base_state = state
        self._spawn()
        self._thread.start()

    def submit(self, work: tuple[Work, ...]) -> tuple[WindowKey, ...]:
        """Queue work in order; returns the keys of the windows that a full queue cost, oldest first."""
        if not work:
            return ()
        dropped: list[WindowKey] = []
        with self._condition:
            for item in work:
                self._pending.append(item)
                self._windows_pending += isinstance(item.item, LinkWindow)
            while self._windows_pending > self._limit:
                dropped.append(self._drop_oldest_window())
            self._condition.notify()
        return tuple(dropped)

    def request_state(self, receive: Callable[[dict[str, Any]], None]) -> None:
        """Ask for the state after all work submitted so far; ``receive`` runs on the lane's thread."""
        with self._condition:
            self._pending.append(receive)
            self._condition.notify()

    @property
    def backlog_windows(self) -> int:
        """Windows queued and not yet taken by the child."""
        return self._windows_pending

    def drain(self, timeout_s: float) -> bool:
        """Wait until all submitted work is answered; whether it was."""
        with self._condition:
            return self._condition.wait_for(lambda: not self._pending and not self._busy, timeout_s)

    def close(self) -> None:
        """End the child. What is still queued is not worked on."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        if self._thread.is_alive():
            self._thread.join(timeout=10)
        if self._pipe is not None:
            with contextlib.suppress(OSError):
                self._pipe.send(("end", None))
            self._pipe.close()
        if self._process is not None:
            self._process.join(timeout=5)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()

    def _drop_oldest_window(self) -> WindowKey:
        for index, item in enumerate(self._pending):
            if isinstance(item, Work) and isinstance(item.item, LinkWindow):
                del self._pending[index]
                self._windows_pending -= 1
                return item.item.key
        raise AssertionError("no window is queued")

    def _spawn(self) -> None:
        ours, theirs = self._context.Pipe()
        self._process = self._context.Process(
            target=estimator_process, args=(self._settings, self._base_state, theirs), daemon=True
        )
        self._process.start()
        theirs.close()
        self._pipe = ours

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: bool(self._pending) or self._closing)
                if self._closing:
                    return
                self._busy = True
                batch, receiver = self._take_batch()
            if batch:
                self._work(batch)
            elif receiver is not None:
                state = self._ask(("state", None))
                if state is not None:
                    self._base_state, self._since_base = state, []
                    receiver(state)
            with self._condition:
                self._busy = False
                self._condition.notify_all()

    def _take_batch(self) -> tuple[list[Work], Callable[[dict[str, Any]], None] | None]:
        batch: list[Work] = []
        while self._pending:
            head = self._pending[0]
            if not isinstance(head, Work):
                if batch:
                    break
                self._pending.popleft()
                return [], head
            self._pending.popleft()
            self._windows_pending -= isinstance(head.item, LinkWindow)
            batch.append(head)
        return batch, None

    def _work(self, batch: list[Work]) -> None:
        answer = self._ask(("work", batch))
        if answer is not None:
            self._since_base.extend(batch)
            self._on_outputs(*answer)
            return
        if self._closing:
            return
        # The child died on this batch: bring it back to where it was and go on without the batch's windows.
        dropped = tuple(w.item.key for w in batch if isinstance(w.item, LinkWindow))
        self._on_failure("the estimator process ended and was started again", dropped)
        self._spawn()
        rest = [w for w in batch if not isinstance(w.item, LinkWindow)]
        # What came of the work before was told then: only the state is wanted again.
        brought_back = self._ask(("work", self._since_base)) is not None
        answer = self._ask(("work", rest)) if brought_back else None
        if answer is None:
            self._on_failure(
                "the estimator process ended again at the same place; its beliefs start anew", ()
            )
            self._base_state, self._since_base = None, []
            self._spawn()
            return
        self._since_base.extend(rest)
        self._on_outputs(*answer)

    def _ask(self, question: tuple[str, Any]) -> Any:
        assert self._pipe is not None
        try:
            self._pipe.send(question)
            return self._pipe.recv()
        except (EOFError, OSError, BrokenPipeError):
            return None
