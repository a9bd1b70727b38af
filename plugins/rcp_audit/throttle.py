"""A flood of refusals is counted and summed up, so that it cannot fill the disk.

A sum is of one tenant: what somebody was refused in one is nothing that another should read of.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import Any

__all__ = ["DenialThrottle"]

_LONGEST = 60.0  # s that one summary covers at most
_SHOWN = 20  # paths that a summary names
_TENANTS = 20  # that have sums of their own; further ones go into that of no tenant


class _Sum:
    """Refusals in one tenant that have no records of their own."""

    __slots__ = ("codes", "paths", "who")

    def __init__(self, who: dict[str, Any]) -> None:
        self.who = who
        self.codes: Counter[str] = Counter()
        self.paths: Counter[str] = Counter()

    def add(self, path: str | None, code: str) -> None:
        self.codes[code] += 1
        if path is not None and (path in self.paths or len(self.paths) < _SHOWN):
            self.paths[path] += 1


class _Window:
    """Refusals of one principal in the running window."""

    __slots__ = ("count", "key", "length", "sums", "timer")

    def __init__(self, key: str, length: float) -> None:
        self.key = key
        self.length = length
        self.timer: asyncio.TimerHandle | None = None
        self.count = 0
        self.sums: dict[str | None, _Sum] = {}

    def sum_of(self, who: dict[str, Any]) -> _Sum:
        tenant = who.get("tenant")
        if tenant not in self.sums and len(self.sums) >= _TENANTS:
            who, tenant = {**who, "tenant": None}, None
        found = self.sums.get(tenant)
        if found is None:
            found = self.sums[tenant] = _Sum(who)
        return found


class DenialThrottle:
    """Lets so many records a second through for each principal, and sums up the others."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, bound: int, tell: Callable[[dict[str, Any]], None]
    ) -> None:
        self._loop = loop
        self.bound = bound
        self._tell = tell
        self._windows: dict[str, _Window] = {}

    def passes(
        self, key: str, who: dict[str, Any], path: str | None, code: str, *, full: bool = False
    ) -> bool:
        """Tell whether this one has a record of its own; else it is counted, as all are if `full`."""
        window = self._windows.get(key)
        if window is None:
            window = self._open(key, 1.0)
        window.count += 1
        # A window that follows a flood counts all: it lasts longer the longer the flood does.
        if window.length == 1.0 and window.count <= self.bound and not full:
            return True
        window.sum_of(who).add(path, code)
        return False

    def _open(self, key: str, length: float) -> _Window:
        window = self._windows[key] = _Window(key, length)
        window.timer = self._loop.call_later(length, self._close, window)
        return window

    def _close(self, window: _Window) -> None:
        key = window.key
        if self._windows.get(key) is not window:
            return
        del self._windows[key]
        self._sum_up(window)
        # Telling may itself be refused and have opened the next one.
        if key not in self._windows and window.sums and window.count > self.bound * window.length:
            self._open(key, min(window.length * 2, _LONGEST))

    def _sum_up(self, window: _Window) -> None:
        for found in window.sums.values():
            self._tell(
                {
                    **found.who,
                    "count": found.codes.total(),
                    "seconds": window.length,
                    "codes": dict(found.codes),
                    "paths": dict(found.paths),
                }
            )

    def close(self) -> None:
        """Sum up what was counted so far."""
        windows, self._windows = self._windows, {}
        for window in windows.values():
            if window.timer is not None:
                window.timer.cancel()
            self._sum_up(window)
