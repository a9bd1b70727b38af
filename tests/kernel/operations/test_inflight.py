"""What becomes of a request's work when its deadline passes at an awkward moment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from inspect import CORO_CLOSED, getcoroutinestate
from types import SimpleNamespace
from typing import Any

from rcp_kernel.wire import Reply, Request
from rcp_requests.inflight import InFlight


class _Deadlines:
    """Deadlines that a test lets pass."""

    missed: Callable[[], None]

    def set(self, seconds: float, owner: Hashable, missed: Callable[[], None]) -> int:
        self.missed = missed
        return 0

    def clear(self, slot: int, owner: Hashable) -> None:
        pass


async def test_work_that_never_began_is_closed_when_its_deadline_passes() -> None:
    deadlines, replies = _Deadlines(), list[Reply]()
    unused: Any = SimpleNamespace(conclude=lambda *_: None)
    session: Any = SimpleNamespace(inflight=set(), principal=None, transport="memory")
    inflight = InFlight(unused, unused, unused, deadlines, asyncio.get_running_loop())  # pyright: ignore[reportArgumentType]
    request = Request(type="read", id="1")

    async def work() -> None:
        raise AssertionError("too late to begin")

    coroutine = work()
    inflight.answer_later(
        session,
        request,
        replies.append,
        coroutine,
        lambda _: Reply(type="read"),
        1.0,
        None,
        urgent=True,
    )
    deadlines.missed()  # the task exists, and has not made its first step
    assert getcoroutinestate(coroutine) == CORO_CLOSED
    await asyncio.sleep(0)
    assert [(reply.error or {})["code"] for reply in replies] == ["deadline_exceeded"]
