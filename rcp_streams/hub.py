"""The hub: links path subscriptions (feeds) to entries, and keeps the links up to date when the tree changes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from rcp_kernel.sessions.notices import notice
from rcp_kernel.sessions.outbox import FlushScheduler
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.tree.samples import Listener
from rcp_scheduling.timers import Timers
from rcp_streams.deadline_monitor import DeadlineMonitor
from rcp_streams.demand import AbsentListener, DemandTracker, absent_listener
from rcp_streams.path_subscription import PathSubscription
from rcp_streams.selection import new_path_subscription
from rcp_streams.shared_fanout import path_subscriptions_of
from rcp_streams.subscription import Subscription

__all__ = ["Hub"]


class Hub:
    """All subscriptions of the gateway."""

    def __init__(
        self, registry: Registry, loop: asyncio.AbstractEventLoop, pattern_value: int
    ) -> None:
        self.registry = registry
        self.loop = loop
        self.pattern_value = pattern_value
        """Longest value, in bytes, sent whole to a subscription that did not name its path."""
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
        """Call a function in the next loop iteration."""
        self.loop.call_soon(function, *args)

    # -- subscriptions -------------------------------------------------------------------------

    def first(self, feed: PathSubscription, last: int) -> None:
        """Send the value that was current at number `last`, and all later ones."""
        entry = feed.entry
        if entry.latest is None:
            return
        samples = [entry.latest]
        if entry.seq != last:
            samples = [sample for sample in entry.ring if sample.seq >= last]
        if not feed.subscription.options.initial and samples[0].seq == last:
            feed.prime(samples.pop(0))
        if samples:
            feed.replay([s for sample in samples if (s := feed.admit(sample)) is not None])
        if self.deadline_monitor.known(entry):
            self.deadline_monitor.tell(feed)

    def let_go(self, feed: PathSubscription) -> None:
        """Remove a feed for good; its queued samples are dropped."""
        self.release(feed)
        self.unlink(feed)
        feed.leave()

    def link(self, subscription: Subscription, feed: PathSubscription) -> None:
        """Start to offer samples to a new feed."""
        entry = feed.entry
        feed.sent = entry.seq
        subscription.feeds[entry.path] = feed
        if subscription.outbox is None:
            feed.outbox = None
            self.retain(feed)
        else:
            feed.outbox = subscription.outbox
            self.relink(feed)
            if feed.priority != 4:
                subscription.outbox.prioritised = True
        subscription.placed(feed)

    def join(self, subscription: Subscription, entry: Entry) -> None:
        """Add an entry to an existing subscription, and notify its client."""
        feed = new_path_subscription(subscription, entry)
        self.link(subscription, feed)
        notice(subscription.outbox, "resource_added", id=subscription.id, path=entry.path)
        if not feed.paused:
            self.first(feed, entry.seq)

    def pause(self, feed: PathSubscription) -> None:
        """Pause sending for a path; its queued samples are dropped."""
        self.let_go(feed)
        feed.outbox = feed.subscription.outbox
        feed.paused = True

    def unpause(self, feed: PathSubscription) -> None:
        """Resume with the current value; samples in between are not replayed."""
        entry = feed.entry
        feed.paused = False
        feed.sent = entry.seq
        feed.outbox = feed.subscription.outbox
        if entry.path not in self.registry.entries:
            return
        if feed.subscription.outbox is None:
            self.retain(feed)
            return
        self.relink(feed)
        self.first(feed, entry.seq)

    def retain(self, feed: PathSubscription) -> None:
        """Keep the history of a feed's path while its client is disconnected."""
        if feed.kept:
            return
        feed.kept = True
        if feed.remote:  # there is no history of its values here
            return
        entry, absent = feed.entry, absent_listener(feed.entry)
        if absent is None:
            absent = AbsentListener()
            entry.listeners.append(absent)
            if len(entry.listeners) == 1:
                entry.size_ring()
        absent.add(feed.subscription.options.rate)
        self.demand.retune(entry)

    def release(self, feed: PathSubscription) -> None:
        """Stop keeping the history for a feed."""
        if not feed.kept:
            return
        feed.kept = False
        entry, absent = feed.entry, absent_listener(feed.entry)
        if feed.remote or absent is None:
            return
        if absent.discard(feed.subscription.options.rate):
            if not absent:
                entry.listeners.remove(absent)
            self._left(entry)

    def relink(self, feed: PathSubscription) -> None:
        """Offer samples to a feed again."""
        entry = feed.entry
        feed.listen(self.flush_scheduler)
        if len(entry.listeners) == 1:
            entry.size_ring()
        feed.heard = entry.clock.monotonic()
        if entry.deadline is not None or feed.subscription.options.qos.deadline is not None:
            self.deadline_monitor.follow(entry)
        self.demand.retune(entry)

    def unlink(self, feed: PathSubscription) -> None:
        """Stop offering samples to a feed."""
        if feed.unlisten():
            self._left(feed.entry)

    def _left(self, entry: Entry) -> None:
        if not entry.listeners:
            if not entry.framed:
                self.deadline_monitor.forget(entry)
            entry.size_ring()
        self.demand.retune(entry)

    def listen(self, entry: Entry, listener: Listener) -> None:
        """Offer every sample to a listener of the gateway, and keep the source running for it."""
        if listener not in entry.listeners:
            entry.listeners.append(listener)
            if len(entry.listeners) == 1:
                entry.size_ring()
        self.demand.retune(entry)

    def unlisten(self, entry: Entry, listener: Listener) -> None:
        """Stop offering samples to a listener."""
        if listener in entry.listeners:
            entry.listeners = [known for known in entry.listeners if known is not listener]
            self._left(entry)

    def drop(self, feed: PathSubscription) -> None:
        """Remove one path from a subscription."""
        del feed.subscription.feeds[feed.entry.path]
        self.let_go(feed)

    def sustain(self, entry: Entry, rate: float) -> None:
        """Keep an entry published at `rate` Hz at least, regardless of subscribers; 0.0 ends this."""
        if entry.sustained != rate:
            entry.sustained = rate
            self.demand.retune(entry)

    # -- changes of the tree -------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        for subscription in list(self.subscriptions):
            known = subscription.feeds.get(entry.path)
            if known is not None:
                returned = known.entry is not entry and known.entry.listeners is not entry.listeners
                known.entry = entry
                if known.paused:
                    continue
                if known.outbox is None:
                    if returned:
                        known.kept = False  # with the removed entry
                        self.retain(known)
                elif known not in path_subscriptions_of(entry):
                    self.relink(known)
                    notice(
                        subscription.outbox, "resource_added", id=subscription.id, path=entry.path
                    )
            elif entry.path not in subscription.awaited and subscription.wants(entry):
                self.join(subscription, entry)
        if entry.listeners:
            if entry.deadline is not None:
                self.deadline_monitor.follow(entry)
            self.demand.retune(entry)

    def _removed(self, entry: Entry) -> None:
        for feed in list(path_subscriptions_of(entry)):
            if feed.unlisten():
                subscription = feed.subscription
                notice(subscription.outbox, "resource_removed", id=subscription.id, path=entry.path)
        self.deadline_monitor.forget(entry)
        entry.listeners = []
        entry.sustained = 0.0
        self.demand.retune(entry)

    async def close(self) -> None:
        """Exit all watches and stop the timers."""
        self._timers.close()
        self.deadline_monitor.close()
        await self.demand.close()
