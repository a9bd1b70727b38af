"""How often conditions of plans are looked at: dear ones less often, and never many in one turn.

A plan may spend a hundredth of its time on conditions. Reading a condition for the first time costs
up to a millisecond, so that is shared out by principal.
"""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Hashable
from contextlib import contextmanager
from time import thread_time

from rcp_kernel.contract.turns import Turns
from rcp_kernel.errors import RateLimited

__all__ = ["Allowance", "Pace"]

_SHARE = 0.01  # of the time, for one plan
_AHEAD = 0.1  # s that a plan may be ahead of its share: cheap conditions are not slowed down
_READING = 0.1  # of the time, for reading the conditions that one principal sends
_READ_AHEAD = 0.2  # s that a principal may be ahead of that
_KNOWN = 1000  # principals


class Allowance:
    """The time for reading conditions that each principal has: a share, and some of it ahead."""

    def __init__(self) -> None:
        self._free: dict[str, float] = {}

    def check(self, principal: str) -> None:
        """Refuse one who has used it up; whoever has not may read all the conditions of a plan.

        :raises RateLimited: it is used up.
        """
        ahead = self._free.get(principal, 0.0) - asyncio.get_running_loop().time() - _READ_AHEAD
        if ahead > 0:
            raise RateLimited(
                "too many new conditions in a short time",
                remedy="Wait, or use conditions that were sent before.",
                retry_after=round(ahead, 3),
            )

    @contextmanager
    def spending(self, principal: str) -> Generator[None]:
        """Count the time while entered."""
        began = thread_time()
        try:
            yield
        finally:
            now = asyncio.get_running_loop().time()
            if len(self._free) >= _KNOWN:
                self._free = {name: free for name, free in self._free.items() if free > now}
            free = max(now, self._free.get(principal, 0.0))
            self._free[principal] = free + (thread_time() - began) / _READING


class Pace:
    """One plan's share."""

    def __init__(self, turns: Turns, owner: Hashable) -> None:
        self._turns = turns
        self._owner = owner
        self._free = 0.0
        """Time at which what was spent so far has become its share."""

    async def wait(self, least: float = 0.0) -> None:
        """Wait until the plan may look at a condition, and `least` seconds in any case."""
        if least:
            await asyncio.sleep(least)
        while True:
            await self._turns.wait(self._owner)
            # Looked at anew after each sleep: another step of the plan may have been first.
            delay = self._free - asyncio.get_running_loop().time() - _AHEAD
            if delay <= 0:
                return
            await asyncio.sleep(delay)

    @contextmanager
    def spending(self) -> Generator[None]:
        """Count the time while entered."""
        began = thread_time()
        try:
            yield
        finally:
            took = thread_time() - began
            self._turns.add(took)
            self._free = max(self._free, asyncio.get_running_loop().time()) + took / _SHARE
