"""Rate of condition evaluation: expensive conditions less often, and never many in one turn.

A plan may spend a hundredth of its time on conditions. Compiling a condition costs up to a
millisecond, so that time is budgeted per principal.
"""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Hashable
from contextlib import contextmanager
from time import thread_time

from rcp_kernel.errors import RateLimited
from rcp_scheduling.turns import Turns

__all__ = ["Allowance", "Pace"]

_SHARE = 0.01  # fraction of the time, per plan
_AHEAD = 0.1  # s that a plan may exceed its share: cheap conditions are not slowed down
_READING = 0.1  # fraction of the time for compiling the conditions of one principal
_READ_AHEAD = 0.2  # s that a principal may exceed that
_KNOWN = 1000  # principals


class Allowance:
    """The time budget of each principal for compiling conditions, with a burst."""

    def __init__(self) -> None:
        self._free: dict[str, float] = {}

    def check(self, principal: str) -> None:
        """Refuse a principal without budget; otherwise all conditions of a plan may be compiled.

        :raises RateLimited: the budget is used up.
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
        """Charge the time spent while entered."""
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
    """The time share of one plan."""

    def __init__(self, turns: Turns, owner: Hashable) -> None:
        self._turns = turns
        self._owner = owner
        self._free = 0.0
        """Time at which the time spent so far equals its share."""

    async def wait(self, least: float = 0.0) -> None:
        """Wait until the plan may evaluate a condition, at least `least` seconds."""
        if least:
            await asyncio.sleep(least)
        while True:
            await self._turns.wait(self._owner)
            # Check again after each sleep: another step of the plan may have been first.
            delay = self._free - asyncio.get_running_loop().time() - _AHEAD
            if delay <= 0:
                return
            await asyncio.sleep(delay)

    @contextmanager
    def spending(self) -> Generator[None]:
        """Charge the time spent while entered."""
        began = thread_time()
        try:
            yield
        finally:
            spent = thread_time() - began
            self._turns.add(spent)
            self._free = max(self._free, asyncio.get_running_loop().time()) + spent / _SHARE
