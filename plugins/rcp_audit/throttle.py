"""Floods of refusals are counted and summarised, so that they cannot fill the disk.

Summaries are per tenant: refusals in one tenant must not be visible to another.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import Any

__all__ = ["DenialThrottle"]

_LONGEST = 60.0  # s, maximum period of a summary
_SHOWN = 20  # paths named in a summary
_TENANTS = 20  # tenants with their own summary; the others share one without a tenant


class _Sum:
    """Refusals in one tenant that have no individual records."""

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
    """Refusals of one principal in the current window."""

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
        total = self.sums.get(tenant)
        if total is None:
            total = self.sums[tenant] = _Sum(who)
        return total


class DenialThrottle:
    """Passes `bound` records per second and principal, and summarises the others."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, bound: int, record: Callable[[dict[str, Any]], None]
    ) -> None:
        self._loop = loop
        self.bound = bound
        self._record = record
        self._windows: dict[str, _Window] = {}

    def passes(
        self, key: str, who: dict[str, Any], path: str | None, code: str, *, full: bool = False
    ) -> bool:
        """Return whether a refusal gets its own record; otherwise, and if `full`, it is counted."""
        window = self._windows.get(key)
        if window is None:
            window = self._open(key, 1.0)
        window.count += 1
        # A window after a flood counts all refusals; its length grows with that of the flood.
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
        # Recording the summary may itself have opened the next window.
        if key not in self._windows and window.sums and window.count > self.bound * window.length:
            self._open(key, min(window.length * 2, _LONGEST))

    def _sum_up(self, window: _Window) -> None:
        for total in window.sums.values():
            self._record(
                {
                    **total.who,
                    "count": total.codes.total(),
                    "seconds": window.length,
                    "codes": dict(total.codes),
                    "paths": dict(total.paths),
                }
            )

    def close(self) -> None:
        """Summarise the current windows, and stop."""
        windows, self._windows = self._windows, {}
        for window in windows.values():
            if window.timer is not None:
                window.timer.cancel()
            self._sum_up(window)
