"""Bytes per second that a gateway may send to all hubs: a token bucket in front of its pipes."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from rcp_zenoh.lane import PART

__all__ = ["Allowance", "Budget"]

_BURST = 0.5  # s of the budget that may be sent at once
_PAUSE = 0.02  # s of the budget that has to be free before updates are sent again
_LEAST_PART = 1024  # bytes


class Allowance:
    """What a pipe asks before it sends updates and long messages; this one allows everything."""

    @property
    def left(self) -> float:
        """Bytes that may be sent now."""
        return math.inf

    @property
    def part(self) -> int:
        """Bytes of one part of a long message."""
        return PART

    def spend(self, size: int) -> None:
        """Count bytes; more than are left make a debt."""

    def call(self, waiting: Callable[[], None]) -> None:
        """Call a function once as soon as something is left."""
        waiting()


class Budget(Allowance):
    """A token bucket."""

    def __init__(self, loop: asyncio.AbstractEventLoop, rate: int) -> None:
        self._loop, self._rate = loop, rate
        self._tokens, self._at = rate * _BURST, loop.time()
        self._waiting: dict[Callable[[], None], None] = {}
        self._timer: asyncio.TimerHandle | None = None

    @property
    def left(self) -> float:
        """Bytes that may be sent now; negative while there is a debt."""
        moment = self._loop.time()
        gained = (moment - self._at) * self._rate
        self._tokens, self._at = min(self._tokens + gained, self._rate * _BURST), moment
        return self._tokens

    @property
    def part(self) -> int:
        """Bytes of one part, which is sent in a twentieth of a second."""
        return min(PART, max(_LEAST_PART, self._rate // 20))

    def spend(self, size: int) -> None:
        """Count bytes; more than are left make a debt."""
        self._tokens = self.left - size

    def call(self, waiting: Callable[[], None]) -> None:
        """Call a function once as soon as something is left."""
        self._waiting[waiting] = None
        if self._timer is None:
            pause = _PAUSE + max(0.0, -self.left / self._rate)
            self._timer = self._loop.call_later(pause, self._wake)

    def _wake(self) -> None:
        self._timer = None
        waiting, self._waiting = self._waiting, {}
        for one in waiting:
            one()
