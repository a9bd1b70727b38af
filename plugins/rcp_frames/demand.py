"""Keeps poses published that are sent only to subscribers, while conversions need them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rcp_kernel.features import Robots
from rcp_kernel.tree.entry import Entry

__all__ = ["PoseDemand"]

_IDLE = 30.0  # s after its last use that a pose is still subscribed to


class PoseDemand:
    """The poses that conversions use."""

    def __init__(self, robots: Robots, loop: asyncio.AbstractEventLoop) -> None:
        self._robots, self._loop = robots, loop
        self._watched: dict[str, _Watched] = {}

    def request(self, entry: Entry) -> None:
        """Keep a pose published, from now on until it is not used for a while."""
        watched = self._watched.get(entry.path)
        if watched is None:
            end = self._robots.watch(entry.path, lambda _: None)
            watched = self._watched[entry.path] = _Watched(end)
            self._loop.call_later(_IDLE, self._look, entry.path)
        watched.used = True

    def _look(self, path: str) -> None:
        watched = self._watched.get(path)
        if watched is None:
            return
        if not watched.used:
            del self._watched[path]
            watched.end()
            return
        watched.used = False
        self._loop.call_later(_IDLE, self._look, path)

    def close(self) -> None:
        """Request nothing more."""
        for watched in self._watched.values():
            watched.end()
        self._watched.clear()


class _Watched:
    """One subscription to a pose."""

    __slots__ = ("end", "used")

    def __init__(self, end: Callable[[], None]) -> None:
        self.end = end
        self.used = True
