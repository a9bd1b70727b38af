"""Requests outside a drive's usual traffic: sent again until a frame answers, whichever node sends it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from rcp_can.bus import Bus, Route

if TYPE_CHECKING:
    import can

__all__ = ["answer_to"]

_AGAIN = 0.1  # s between two requests


async def answer_to(
    bus: Bus,
    routes: Sequence[Route],
    send: Callable[[], object],
    matches: Callable[[can.Message], bool],
    *,
    seconds: float,
    once: bool = False,
) -> can.Message | None:
    """Return the first frame that `matches`; None if there is none within `seconds`.

    `once` is for what must not be repeated: storing wears the drive's memory.

    :raises AdapterUnavailable: the bus is down, or off.
    """
    loop = asyncio.get_running_loop()
    found: asyncio.Future[can.Message] = loop.create_future()

    def take(message: can.Message) -> None:
        if not found.done() and matches(message):
            found.set_result(message)

    end = loop.time() + seconds
    with bus.overheard(take, routes):
        while (left := end - loop.time()) > 0:
            send()
            await asyncio.wait((found,), timeout=left if once else min(_AGAIN, left))
            if found.done():
                return found.result()
    return None
