"""Names of links, used again and again: Zenoh cannot declare keys for ever new ones."""

from __future__ import annotations

import secrets
from collections import Counter, defaultdict, deque
from collections.abc import Callable
from typing import NamedTuple

__all__ = ["LinkNames"]

_REST = 60.0  # s after the end of a link, by when its last messages have arrived or are lost
_MANY = 16_384  # names of all gateways; each takes two of the 65,535 numbers of Zenoh


class _Resting(NamedTuple):
    until: float
    name: str


class LinkNames:
    """The names of a hub's links; another run of the hub has others."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._run = secrets.token_hex(4)
        self._made = Counter[str]()
        self._resting = defaultdict[str, deque[_Resting]](deque)
        """By gateway; the one that has rested longest comes first."""

    def take(self, gateway: str) -> str:
        """Return a name for a link with a gateway: a new one only if none has rested.

        When there are many, because the links of a whole fleet end again and again, the one that
        has rested longest will do: a link that an old message reaches ends, and is made again.
        """
        resting = self._resting[gateway]
        many = self._made.total() >= _MANY
        if resting and (many or resting[0].until <= self._clock()):
            return resting.popleft().name
        self._made[gateway] += 1
        return f"{self._run}-{self._made[gateway]}"

    def release(self, gateway: str, name: str) -> None:
        """Let the name of a link that has ended rest."""
        self._resting[gateway].append(_Resting(self._clock() + _REST, name))
