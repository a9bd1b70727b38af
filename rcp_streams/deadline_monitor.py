"""Notices to subscribers about stale values, and about missed deadlines of their own."""

from __future__ import annotations

import asyncio

from rcp_kernel.sessions.notices import notice
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_streams.path_subscription import PathSubscription
from rcp_streams.shared_fanout import path_subscriptions_of

__all__ = ["DeadlineMonitor"]

_SWEEP = 0.1  # s between checks for stale values


class DeadlineMonitor:
    """Periodically checks every path with a subscriber that wants to know about missing samples."""

    def __init__(self, registry: Registry, loop: asyncio.AbstractEventLoop) -> None:
        self._registry = registry
        self._loop = loop
        self._timed: dict[str, bool] = {}
        """By path, whether it was last reported as stale."""
        self._sweep: asyncio.TimerHandle | None = None

    def known(self, entry: Entry) -> bool:
        """Return whether subscribers were notified that an entry is stale."""
        return self._timed.get(entry.path, False)

    def follow(self, entry: Entry) -> None:
        """Start to monitor an entry."""
        self._timed.setdefault(entry.path, entry.latest is not None and entry.stale)
        if self._sweep is None:
            self._sweep = self._loop.call_later(_SWEEP, self.poll)

    def forget(self, entry: Entry) -> None:
        """Stop monitoring an entry."""
        self._timed.pop(entry.path, None)

    def poll(self) -> None:
        """Report the paths that became stale since the last check."""
        self._sweep = None
        moment = self._registry.clock.monotonic()
        for path, known in list(self._timed.items()):
            entry = self._registry.entries[path]
            stale = entry.latest is not None and entry.stale
            if stale is not known:
                self._timed[path] = stale
            for feed in path_subscriptions_of(entry):
                if stale and not known:
                    self.tell(feed)
                self._check_deadline(feed, moment)
        if self._timed:
            self._sweep = self._loop.call_later(_SWEEP, self.poll)

    def tell(self, feed: PathSubscription) -> None:
        """Notify one subscriber that a value is stale, unless the robot's own gateway sends its values."""
        if feed.remote:
            return
        age = feed.entry.age
        notice(
            feed.outbox,
            "stale",
            id=feed.subscription.id,
            path=feed.entry.path,
            seq=feed.entry.seq,
            age=round(age, 3) if age is not None else None,
            message=f"{feed.entry.path} has sent no new sample within its deadline",
        )

    def _check_deadline(self, feed: PathSubscription, moment: float) -> None:
        limit = feed.subscription.options.qos.deadline
        if limit is None:
            return
        age = None if feed.remote else feed.entry.age
        late = moment - feed.heard > limit and (age is None or age > limit)
        if late and not feed.missed:
            notice(
                feed.outbox,
                "deadline_missed",
                id=feed.subscription.id,
                path=feed.entry.path,
                message=f"no update of {feed.entry.path} for {limit} s",
            )
        feed.missed = late

    def close(self) -> None:
        """Stop."""
        if self._sweep is not None:
            self._sweep.cancel()
