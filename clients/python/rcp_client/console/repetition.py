"""`--watch`: a listing again and again, whole on a terminal, only what is new for a program."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from rcp_client.console.output import Output

__all__ = ["repeat"]

_PERIOD = 1.0  # s
_CLEAR = "\x1b[H\x1b[2J\x1b[3J"


async def repeat(out: Output, show: Callable[[], Awaitable[int]]) -> int:
    """Show a listing until Ctrl-C, or until it fails."""
    while True:
        if out.terminal and not out.json:
            out.line(_CLEAR)
        out.begin_round()
        code = await show()
        if code:
            return code
        await asyncio.sleep(_PERIOD)
