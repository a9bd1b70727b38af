"""The hub keeps subscriptions linked to the tree as both change.

It links feeds to entries, and replays what a client missed.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcp_kernel.clients.outbox import FlushScheduler, Outbox
from rcp_kernel.registry import Entry, Listener, Registry
from rcp_kernel.streaming.deadline_monitor import DeadlineMonitor
from rcp_kernel.streaming.demand import AbsentListener, DemandTracker, absent_listener
from rcp_kernel.streaming.notices import notice
from rcp_kernel.streaming.path_subscription import PathSubscription
from rcp_kernel.streaming.samples import Sample
from rcp_kernel.streaming.shared_fanout import (
    SharedPathSubscription,
    join_fanout,
    leave_fanout,
    path_subscriptions_of,
)
from rcp_kernel.streaming.subscription import Subscription
from rcp_kernel.timers import Timers

__all__ = ["Hub"]

_LONGEST = 86_400.0 * 365  # s: no timer reaches further


class Hub:
    """Every subscription of the gateway."""

    def __init__(
        self, registry: Registry, loop: asyncio.AbstractEventLoop, pattern_value: int
    ) -> None:
        self.registry = registry
        self.loop = loop
        self.pattern_value = pattern_value
        """Longest value, bytes, that is sent whole to a subscription that did not name its path."""
        self.flush_scheduler = FlushScheduler(loop)
        self.subscriptions: set[Subscription] = set()
        self.dropped: dict[str, int] = {"conflated": 0, "overrun": 0, "gap": 0}
        self._timers = Timers(loop)
        self.later = self._timers.later
        self.deadline_monitor = DeadlineMonitor(registry, loop)
        self.demand = DemandTracker(registry, loop, self.later)
        registry.on_added.append(self._added)
        registry.on_removed.append(self._removed)

    def soon(self, function: Callable[..., object], *args: Any) -> None:
        """Call a function in the coming loop turn."""
        self.loop.call_soon(function, *args)

    # -- subscriptions -------------------------------------------------------------------------

    def add(self, subscription: Subscription, entries: list[Entry]) -> None:
        """Start a subscription on the entries that it matches now; later ones join by themselves."""
        self.subscriptions.add(subscription)
        options = subscription.options
        for entry in entries:
            feed = self._link(subscription, entry)
            if feed.paused:
                continue
            if options.history:
                feed.replay(subscription.past(feed, options.history))
            elif entry.latest is not None:
                self._first(feed, entry.latest)
        if options.duration is not None:
            subscription.timer = self.loop.call_later(
                min(options.duration, _LONGEST), subscription.end, subscription, "duration", None
            )

    def _first(self, feed: PathSubscription, sample: Sample) -> None:
        if not feed.subscription.options.initial:
            feed.prime(sample)
        elif feed.admit(sample):
            feed.replay((sample,))
        if self.deadline_monitor.known(feed.entry):
            self.deadline_monitor.tell(feed)

    def remove(self, subscription: Subscription) -> None:
        """End a subscription; what it has queued is forgotten."""
        self.subscriptions.discard(subscription)
        if subscription.timer is not None:
            subscription.timer.cancel()
        for feed in subscription.feeds.values():
            self.unlink(feed)
            feed.leave()
            self.dropped["conflated"] += feed.skipped
        subscription.feeds.clear()

    def _link(self, subscription: Subscription, entry: Entry) -> PathSubscription:
        feed = subscription.feed(entry)
        subscription.feeds[entry.path] = feed
        if subscription.outbox is None:
            self._keep(feed)
        else:
            self._relink(feed)
            if feed.priority != 4:
                subscription.outbox.prioritised = True
        subscription.placed(feed)
        return feed

    def join(self, subscription: Subscription, entry: Entry) -> None:
        """Add an entry to a subscription that stands, and tell its client."""
        feed = self._link(subscription, entry)
        notice(subscription.outbox, "resource_added", id=subscription.id, path=entry.path)
        if entry.latest is not None and not feed.paused:
            self._first(feed, entry.latest)

    def pause(self, feed: PathSubscription) -> None:
        """Send nothing more of a path for now; what waits is forgotten."""
        if feed.subscription.outbox is None:
            self._unkeep(feed)
        self.unlink(feed)
        feed.leave()
        feed.outbox = feed.subscription.outbox
        feed.paused = True

    def unpause(self, feed: PathSubscription) -> None:
        """Go on with the present value; what came meanwhile is not missed."""
        entry = feed.entry
        feed.paused = False
        feed.sent = entry.seq
        if entry.path not in self.registry.entries:
            return
        if feed.subscription.outbox is None:
            self._keep(feed)
            return
        self._relink(feed)
        if entry.latest is not None:
            self._first(feed, entry.latest)

    def _keep(self, feed: PathSubscription) -> None:
        """Have the history of a path kept for a client that is away."""
        _hold(feed.entry, feed.subscription.options.rate)
        self.demand.retune(feed.entry)

    def _relink(self, feed: PathSubscription) -> None:
        entry = feed.entry
        if isinstance(feed, SharedPathSubscription):
            join_fanout(feed, entry)
        else:
            entry.listeners.append(feed)
        if len(entry.listeners) == 1:
            entry.size_ring()
        feed.heard = time.monotonic()
        if entry.deadline is not None or feed.subscription.options.qos.deadline is not None:
            self.deadline_monitor.follow(entry)
        self.demand.retune(entry)

    def unlink(self, feed: PathSubscription) -> None:
        """Offer a feed nothing more."""
        if self._cut(feed):
            self._left(feed.entry)

    def _left(self, entry: Entry) -> None:
        if not entry.listeners:
            self.deadline_monitor.forget(entry)
            entry.size_ring()
        self.demand.retune(entry)

    @staticmethod
    def _cut(feed: PathSubscription) -> bool:
        """Take a feed from its entry's listeners; tell whether it was among them."""
        if isinstance(feed, SharedPathSubscription):
            return leave_fanout(feed, feed.entry)
        entry = feed.entry
        if feed not in entry.listeners:
            return False
        # A new list: the old one may be the one that a sample is being offered to right now.
        entry.listeners = [listener for listener in entry.listeners if listener is not feed]
        return True

    @staticmethod
    def plain_feed(
        subscription: Subscription, entry: Entry, outbox: Outbox | None
    ) -> PathSubscription:
        """Make the feed of a subscription that wants every sample as it comes."""
        options = subscription.options
        alone = options.qos.reliability == "reliable" or (outbox is not None and outbox.alone)
        kind = PathSubscription if alone or options.count is not None else SharedPathSubscription
        return kind(subscription, entry, outbox)

    @staticmethod
    def keep(entry: Entry) -> None:
        """Have the whole history of a path kept although nobody may be listening."""
        _hold(entry, 0.0)

    def listen(self, entry: Entry, listener: Listener) -> None:
        """Offer the gateway's own listener every sample, and keep the source running for it."""
        if listener not in entry.listeners:
            entry.listeners.append(listener)
            if len(entry.listeners) == 1:
                entry.size_ring()
        self.demand.retune(entry)

    def unlisten(self, entry: Entry, listener: Listener) -> None:
        """Offer a listener nothing more."""
        if listener in entry.listeners:
            entry.listeners = [known for known in entry.listeners if known is not listener]
            self._left(entry)

    # -- cut and resume ------------------------------------------------------------------------

    def detach(self, subscription: Subscription) -> None:
        """Stop sending: the connection is gone. The history of its paths goes on being kept."""
        subscription.outbox = None
        for path, feed in subscription.feeds.items():
            feed.leave()
            if path in self.registry.entries and not feed.paused:
                self._keep(feed)  # before the feed goes, so that its source goes on
            self.unlink(feed)

    def attach(
        self, subscription: Subscription, outbox: Outbox, missed_from: dict[str, int] | None
    ) -> None:
        """Go on sending, what was missed first; `missed_from` is what the client has, by path."""
        subscription.outbox = outbox
        for path, feed in subscription.feeds.items():
            feed.outbox = outbox
            if feed.paused:
                continue
            known = feed.sent if missed_from is None else missed_from.get(path, feed.sent)
            self._replay(feed, known)
            if path in self.registry.entries:
                self._relink(feed)
            self._unkeep(feed)
            if feed.priority != 4:
                outbox.prioritised = True

    def _replay(self, feed: PathSubscription, known: int) -> None:
        ring = feed.entry.ring
        if feed.entry.seq <= known:
            return
        oldest = ring[0].seq if ring else feed.entry.seq + 1
        if oldest > known + 1:
            lost = oldest - known - 1
            self.dropped["gap"] += lost
            notice(
                feed.outbox,
                "gap",
                id=feed.subscription.id,
                path=feed.entry.path,
                lost=lost,
                first=known + 1,
                last=oldest - 1,
                message=f"{lost} samples of {feed.entry.path} are no longer in the replay buffer",
            )
        feed.replay([s for s in ring if s.seq > known and feed.admit(s)])

    def forget(self, subscription: Subscription) -> None:
        """Let go of a detached subscription whose session has expired."""
        if subscription.outbox is None:
            for feed in subscription.feeds.values():
                self._unkeep(feed)
        self.remove(subscription)

    def drop(self, feed: PathSubscription) -> None:
        """Take one path out of a subscription."""
        subscription = feed.subscription
        del subscription.feeds[feed.entry.path]
        if subscription.outbox is None:
            self._unkeep(feed)
        self.unlink(feed)
        feed.leave()

    def _unkeep(self, feed: PathSubscription) -> None:
        entry, absent = feed.entry, absent_listener(feed.entry)
        if absent is not None and absent.discard(feed.subscription.options.rate):
            if not absent:
                entry.listeners.remove(absent)
            self._left(entry)

    def sustain(self, entry: Entry, rate: float) -> None:
        """Have an entry published at `rate` Hz at least, whoever listens; 0.0: no more."""
        if entry.sustained != rate:
            entry.sustained = rate
            self.demand.retune(entry)

    # -- the tree changes ----------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        for subscription in list(self.subscriptions):
            known = subscription.feeds.get(entry.path)
            if known is not None:
                returned = known.entry is not entry and known.entry.listeners is not entry.listeners
                known.entry = entry
                if known.paused:
                    continue
                if subscription.outbox is None:
                    if returned:
                        self._keep(known)
                elif known not in path_subscriptions_of(entry):
                    self._relink(known)
                    notice(
                        subscription.outbox, "resource_added", id=subscription.id, path=entry.path
                    )
            elif subscription.wants(entry):
                self.join(subscription, entry)
        if entry.listeners:
            if entry.deadline is not None:
                self.deadline_monitor.follow(entry)
            self.demand.retune(entry)

    def _removed(self, entry: Entry) -> None:
        for feed in list(path_subscriptions_of(entry)):
            if self._cut(feed):
                subscription = feed.subscription
                notice(subscription.outbox, "resource_removed", id=subscription.id, path=entry.path)
        self.deadline_monitor.forget(entry)
        entry.listeners = []
        entry.sustained = 0.0
        self.demand.retune(entry)

    async def close(self) -> None:
        """Leave every watch and stop the timers."""
        self._timers.close()
        self.deadline_monitor.close()
        await self.demand.close()


def _hold(entry: Entry, rate: float | None) -> None:
    """Have an entry's history kept for somebody who wants `rate` of its source."""
    absent = absent_listener(entry)
    if absent is None:
        absent = AbsentListener()
        entry.listeners.append(absent)
        if len(entry.listeners) == 1:
            entry.size_ring()
    absent.add(rate)
