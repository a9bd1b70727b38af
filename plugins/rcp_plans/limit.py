"""The deadlines of steps: many that pass at once end one after the other, not in one turn of the loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Hashable
from contextlib import asynccontextmanager

from rcp_kernel.contract.turns import Turns

__all__ = ["paced_timeout"]


@asynccontextmanager
async def paced_timeout(
    turns: Turns, owner: Hashable, seconds: float | None
) -> AsyncGenerator[None]:
    """Do as `asyncio.timeout`, when there is a turn for it.

    :raises TimeoutError: what is done while entered took longer.
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

    async with asyncio.timeout(None) as limit:
        timer = loop.call_later(seconds, expire)
        try:
            yield
        finally:
            entered = False
            timer.cancel()
