"""A flood of refusals is counted and told in one record, so that it cannot fill the disk."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import Any

__all__ = ["Flood"]

_LONGEST = 60.0  # s that one summary covers at most
_SHOWN = 20  # paths that a summary names


class _Window:
    """Refusals of one principal in the running window."""

    __slots__ = ("codes", "count", "length", "paths", "who")

    def __init__(self, length: float, who: dict[str, Any]) -> None:
        self.length = length
        self.who = who
        self.count = 0
        self.codes: Counter[str] = Counter()
        self.paths: Counter[str] = Counter()


class Flood:
    """Lets so many records a second through for each principal, and sums up the others."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, bound: int, tell: Callable[[dict[str, Any]], None]
    ) -> None:
        self._loop = loop
        self.bound = bound
        self._tell = tell
        self._windows: dict[str, _Window] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}

    def passes(
        self, key: str, who: dict[str, Any], path: str | None, code: str, *, full: bool = False
    ) -> bool:
        """Tell whether this one has a record of its own; else it is counted, as all are if `full`."""
        window = self._windows.get(key)
        if window is None:
            window = self._open(key, 1.0, who)
        window.count += 1
        # A window that follows a flood counts all: it lasts longer the longer the flood does.
        if window.length == 1.0 and window.count <= self.bound and not full:
            return True
        window.codes[code] += 1
        if path is not None and (path in window.paths or len(window.paths) < _SHOWN):
            window.paths[path] += 1
        return False

    def _open(self, key: str, length: float, who: dict[str, Any]) -> _Window:
        window = self._windows[key] = _Window(length, who)
        self._timers[key] = self._loop.call_later(length, self._close, key)
        return window

    def _close(self, key: str) -> None:
        window = self._windows.pop(key)
        del self._timers[key]
        if not window.codes:
            return
        self._sum_up(window)
        if window.count > self.bound * window.length:
            self._open(key, min(window.length * 2, _LONGEST), window.who)

    def _sum_up(self, window: _Window) -> None:
        self._tell(
            {
                **window.who,
                "count": sum(window.codes.values()),
                "seconds": window.length,
                "codes": dict(window.codes),
                "paths": dict(window.paths),
            }
        )

    def close(self) -> None:
        """Sum up what was counted so far."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        windows, self._windows = self._windows, {}
        for window in windows.values():
            if window.codes:
                self._sum_up(window)
