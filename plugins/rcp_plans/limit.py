"""Deadlines of steps, spread over turns of the event loop when many expire at once."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Hashable
from contextlib import asynccontextmanager

from rcp_protocol.timeouts import timeout
from rcp_scheduling.turns import Turns

__all__ = ["paced_timeout"]


@asynccontextmanager
async def paced_timeout(
    turns: Turns, owner: Hashable, seconds: float | None
) -> AsyncGenerator[None]:
    """Act as `asyncio.timeout`, but expire only when the event loop has a turn to spare.

    :raises TimeoutError: the body took longer than `seconds`.
    """
    if seconds is None:
        yield
        return
    loop = asyncio.get_running_loop()
    entered = True

    def expire() -> None:
        turns.place(owner).add_done_callback(end)

    def end(_place: asyncio.Future[None]) -> None:
        if entered:
            limit.reschedule(loop.time())

    async with timeout(None) as limit:
        timer = loop.call_later(seconds, expire)
        try:
            yield
        finally:
            entered = False
            timer.cancel()
