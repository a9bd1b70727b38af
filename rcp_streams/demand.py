"""Sources kept running while they have subscribers, at the highest rate that any of them needs.

One task per source enters and exits `Backend.watch`, and enters it again if it fails.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from contextlib import AsyncExitStack
from contextvars import Context

import structlog

from rcp_kernel.errors import RcpError
from rcp_kernel.spi import has_watch
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.tree.samples import Sample
from rcp_streams.path_subscription import PathSubscription

__all__ = ["AbsentListener", "DemandTracker", "absent_listener"]

log = structlog.get_logger("rcp.streams")
_WATCH_RETRY = 1.0  # s before a failed watch is entered again


class DemandTracker:
    """All sources in demand."""

    def __init__(
        self,
        registry: Registry,
        loop: asyncio.AbstractEventLoop,
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:
        self._registry = registry
        self._loop = loop
        self._later = later
        self._watches: dict[str, _Watch] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False

    def holds(self, entry: Entry) -> bool:
        """Return whether the source of an entry is kept running."""
        return entry.path in self._watches

    def retune(self, entry: Entry) -> None:
        """Watch an entry at the rate that its listeners currently need."""
        backend = entry.owner.backend
        if backend is None or not has_watch(backend):
            rate: float | None = 0.0
        else:
            rate = _wanted_rate(entry)
        watch = self._watches.get(entry.path)
        if watch is None:
            if rate == 0.0:
                return
            watch = self._watches[entry.path] = _Watch(entry)
            # In no context: it is for all subscribers, and outlives the first one's request.
            task = self._loop.create_task(
                watch.run(), name=f"watch {entry.path}", context=Context()
            )
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            task.add_done_callback(lambda _: self._watch_ended(entry.path, watch))
        watch.want(entry, rate)
        if rate == 0.0:
            del self._watches[entry.path]

    def _watch_ended(self, path: str, watch: _Watch) -> None:
        """Enter a watch again that ended despite demand, after a delay."""
        if not self._closed and self._watches.get(path) is watch:
            self._later(_WATCH_RETRY, lambda: self._rewatch(path, watch))

    def _rewatch(self, path: str, watch: _Watch) -> None:
        if self._watches.get(path) is watch:
            del self._watches[path]
            if (entry := self._registry.entries.get(path)) is not None:
                self.retune(entry)

    def backend_changed(self, entries: list[Entry]) -> None:
        """Watch the sources of a reopened backend again; drop those that it no longer has."""
        for entry in entries:
            if (watch := self._watches.pop(entry.path, None)) is not None:
                watch.want(entry, 0.0)
            self.retune(entry)
            for feed in entry.framed:
                feed.follow()

    async def close(self) -> None:
        """Exit all watches."""
        self._closed = True
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


class AbsentListener:
    """Represents all feeds of an entry with disconnected clients, so that its history is kept.

    One per entry: there may be as many disconnected clients as sessions, and every sample is
    offered to every listener.
    """

    __slots__ = ("_rates",)

    def __init__(self) -> None:
        self._rates: Counter[float | None] = Counter()

    def __len__(self) -> int:
        return self._rates.total()

    def add(self, rate: float | None) -> None:
        """Add a feed that needs `rate` from the source."""
        self._rates[rate] += 1

    def discard(self, rate: float | None) -> bool:
        """Remove a feed; return whether there was one."""
        count = self._rates[rate]
        if count > 1:
            self._rates[rate] = count - 1
        else:
            del self._rates[rate]
        return count > 0

    @property
    def rate(self) -> float | None:
        """The highest rate needed; None for every sample."""
        if None in self._rates:
            return None
        return max((rate or 0.0 for rate in self._rates), default=0.0)

    def offer(self, sample: Sample) -> None:
        """Do nothing: the entry's ring buffer has the sample."""


def absent_listener(entry: Entry) -> AbsentListener | None:
    """Return the listener for the disconnected clients of an entry."""
    return next((one for one in entry.listeners if isinstance(one, AbsentListener)), None)


def _wanted_rate(entry: Entry) -> float | None:
    """The highest rate needed, in Hz; None for every sample, 0.0 without demand."""
    best = entry.sustained
    for listener in entry.listeners:
        if isinstance(listener, AbsentListener):
            rate = listener.rate
        else:
            rate = (
                listener.subscription.options.rate
                if isinstance(listener, PathSubscription)
                else None
            )
        if rate is None:
            return None
        best = max(best, rate)
    return best


class _Watch:
    """One source kept running: enters the next `watch` before it exits the last."""

    def __init__(self, entry: Entry) -> None:
        self._entry = entry
        self._rate: float | None = 0.0
        self._changed = asyncio.Event()

    def want(self, entry: Entry, rate: float | None) -> None:
        if rate != self._rate:
            self._entry = entry
            self._rate = rate
            self._changed.set()

    async def run(self) -> None:
        current = AsyncExitStack()
        try:
            while True:
                await self._changed.wait()
                self._changed.clear()
                rate, backend = self._rate, self._entry.owner.backend
                if rate == 0.0 or backend is None:
                    return
                following = AsyncExitStack()
                await following.enter_async_context(backend.watch(self._entry.name, rate))
                await current.aclose()
                current = following
        except RcpError as error:
            self._entry.owner.fault(f"cannot watch {self._entry.path}: {error.message}")
        except Exception:
            log.exception("watch_failed", path=self._entry.path, backend=self._entry.owner.name)
            self._entry.owner.fault(f"watching {self._entry.path} failed; see the log")
        finally:
            await current.aclose()
