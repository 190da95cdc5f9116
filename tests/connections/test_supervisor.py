"""The supervisor: longer waits after each failure, short again after a long life, our own faults final."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import pytest

from groundstation.connections.settings import ConnectionSettings
from groundstation.connections.supervisor import LinkState, Supervisor
from groundstation.domain.errors import PeerError


class Port:
    """A transport that breaks when told."""

    local_address = None

    def __init__(self) -> None:
        self.broken: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.closed = 0

    def send(self, data: bytes, address: object) -> bool:
        return True

    def confirm(self, address: object) -> None: ...

    def audience(self) -> list[Any]:
        return []

    def send_errors(self) -> int:
        return 0

    async def wait_closed(self) -> str:
        return await asyncio.shield(self.broken)

    async def close(self) -> None:
        self.closed += 1


async def eventually(condition: Callable[[], Any]) -> None:
    """Waits, bounded."""
    async with asyncio.timeout(5):
        while not condition():  # noqa: ASYNC110 - nothing to wait for but the outcome
            await asyncio.sleep(0.002)


async def stop(task: asyncio.Task[None]) -> None:
    """Cancels and waits."""
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task


async def test_waits_grow_to_a_limit_and_shrink_after_a_long_life() -> None:
    said: list[tuple[LinkState, str]] = []
    ports: list[Port] = []
    tries = 0

    async def open_port() -> Port:
        nonlocal tries
        tries += 1
        if tries in (1, 2, 3, 4):
            raise PeerError("nobody there")
        ports.append(Port())
        return ports[-1]

    settings = ConnectionSettings(backoff_initial_s=0.01, backoff_max_s=0.04, stable_after_s=0.05)
    supervisor = Supervisor(open_port, lambda state, detail: said.append((state, detail)), settings)
    task = asyncio.create_task(supervisor.run())
    await eventually(lambda: ports)
    assert [detail for _state, detail in said[:4]] == [
        f"nobody there; next try in {delay} s" for delay in ("0.01", "0.02", "0.04", "0.04")
    ]
    ports[0].broken.set_result("pulled")
    await eventually(lambda: len(ports) == 2)
    assert said[4:8] == [
        (LinkState.OPEN, ""),
        (LinkState.CLOSED, "pulled"),
        (LinkState.WAITING, "pulled; next try in 0.04 s"),
        (LinkState.OPEN, ""),
    ]
    await asyncio.sleep(0.06)
    ports[1].broken.set_result("pulled again")
    await eventually(lambda: len(ports) == 3)
    assert said[9] == (LinkState.WAITING, "pulled again; next try in 0.01 s")
    assert (supervisor.opened, supervisor.failures) == (3, 4)
    await stop(task)
    assert said[-1] == (LinkState.CLOSED, "closed by the station")
    assert [port.closed for port in ports] == [1, 1, 1]
    assert supervisor.transport is None


async def test_opening_takes_its_time_only_so_long() -> None:
    said: list[tuple[LinkState, str]] = []

    async def never() -> Port:
        await asyncio.sleep(60)
        raise AssertionError

    settings = ConnectionSettings(connect_timeout_s=0.02)
    task = asyncio.create_task(
        Supervisor(never, lambda state, detail: said.append((state, detail)), settings).run()
    )
    await eventually(lambda: said)
    assert said == [(LinkState.WAITING, "no answer within 0.02 s; next try in 0.5 s")]
    await stop(task)


async def test_a_fault_of_ours_is_reported_and_final() -> None:
    said: list[tuple[LinkState, str]] = []
    faults: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: faults.append(context))

    async def broken() -> Port:
        raise KeyError("a fault of ours")

    supervisor = Supervisor(broken, lambda state, detail: said.append((state, detail)), ConnectionSettings())
    await asyncio.wait_for(supervisor.run(), 5)
    await supervisor.tried()
    assert said == [(LinkState.FAILED, "internal fault: KeyError: 'a fault of ours'")]
    assert isinstance(faults[0]["exception"], KeyError)


@pytest.mark.parametrize("state", list(LinkState))
def test_states_are_the_journals_words(state: LinkState) -> None:
    assert state.value in {"open", "closed", "waiting", "failed"}
