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
from rcp_kernel.streaming.history import admitted, past
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
from rcp_kernel.turns import Turns, Work

__all__ = ["Hub"]

_STEP = 32  # paths that are linked or let go of at once
_STREAMS = "streams"  # with an owner: what is done for its subscriptions, beside its requests
_LONGEST = 86_400.0 * 365  # s: no timer reaches further


class Hub:
    """Every subscription of the gateway."""

    def __init__(
        self,
        registry: Registry,
        turns: Turns,
        loop: asyncio.AbstractEventLoop,
        pattern_value: int,
    ) -> None:
        self.registry = registry
        self._turns = turns
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
        """Start a subscription on the entries that it matches now; later ones join by themselves.

        They are linked in steps: some of them may be when this returns.
        """
        self.subscriptions.add(subscription)
        subscription.awaited = {entry.path: entry.seq for entry in entries}
        duration = subscription.options.duration
        if duration is not None:
            subscription.timer = self.loop.call_later(
                min(duration, _LONGEST), subscription.end, subscription, "duration", None
            )
        self._begin(subscription, self._link_awaited(subscription))

    def _begin(self, subscription: Subscription, work: Work) -> None:
        self._turns.oblige((_STREAMS, subscription.owner), work)

    def _link_awaited(self, subscription: Subscription) -> Work:
        awaited = subscription.awaited
        for number, path in enumerate(tuple(awaited), 1):
            if path in awaited:  # until it ends
                yield from self._link_path(subscription, path)
                awaited.pop(path, None)
            if not number % _STEP:
                yield

    def _link_path(self, subscription: Subscription, path: str) -> Work:
        entry = self.registry.entries.get(path)
        if entry is None or not subscription.may(entry):  # since the client was told of it
            notice(subscription.outbox, "resource_removed", id=subscription.id, path=path)
            return
        feed = subscription.feed(entry)
        history, last = subscription.options.history, subscription.awaited[path]
        samples: list[Sample] = []
        if history:
            samples = yield from admitted(feed, past(feed, history, last))
            if path not in subscription.awaited:
                return
            if self.registry.entries.get(path) is not entry:  # another one by now, or none
                yield from self._link_path(subscription, path)
                return
        self._link(subscription, feed)
        if feed.paused:
            return
        if history:
            feed.replay(samples)
        else:
            self._first(feed, last)

    def _first(self, feed: PathSubscription, last: int) -> None:
        """Send the value that was the present one with number `last`, and all that came since."""
        entry = feed.entry
        if entry.latest is None:
            return
        samples = [entry.latest]
        if entry.seq != last:
            samples = [sample for sample in entry.ring if sample.seq >= last]
        if not feed.subscription.options.initial and samples[0].seq == last:
            feed.prime(samples.pop(0))
        if samples:
            feed.replay([told for one in samples if (told := feed.admit(one)) is not None])
        if self.deadline_monitor.known(entry):
            self.deadline_monitor.tell(feed)

    def remove(
        self, subscription: Subscription, leaving: Callable[[PathSubscription], None] | None = None
    ) -> Work:
        """End a subscription in steps, `leaving` called with each feed before it goes.

        What it has queued is forgotten. Until the last step it may still send.
        """
        self.subscriptions.discard(subscription)
        subscription.awaited.clear()
        if subscription.timer is not None:
            subscription.timer.cancel()
        return self._remove_feeds(subscription, leaving)

    def _remove_feeds(
        self, subscription: Subscription, leaving: Callable[[PathSubscription], None] | None
    ) -> Work:
        feeds = subscription.feeds
        for number, path in enumerate(tuple(feeds), 1):
            feed = feeds.pop(path, None)
            if feed is not None:
                if leaving is not None:
                    leaving(feed)
                self._let_go(feed)
            if not number % _STEP:
                yield

    def _let_go(self, feed: PathSubscription) -> None:
        self._unkeep_for(feed)
        self.unlink(feed)
        feed.leave()
        self.dropped["conflated"] += feed.skipped

    def _link(self, subscription: Subscription, feed: PathSubscription) -> None:
        entry = feed.entry
        feed.sent = entry.seq
        subscription.feeds[entry.path] = feed
        if subscription.outbox is None:
            feed.outbox = None
            self._keep_for(feed)
        else:
            feed.outbox = subscription.outbox
            self._relink(feed)
            if feed.priority != 4:
                subscription.outbox.prioritised = True
        subscription.placed(feed)

    def join(self, subscription: Subscription, entry: Entry) -> None:
        """Add an entry to a subscription that stands, and tell its client."""
        feed = subscription.feed(entry)
        self._link(subscription, feed)
        notice(subscription.outbox, "resource_added", id=subscription.id, path=entry.path)
        if not feed.paused:
            self._first(feed, entry.seq)

    def pause(self, feed: PathSubscription) -> None:
        """Send nothing more of a path for now; what waits is forgotten."""
        self._unkeep_for(feed)
        self.unlink(feed)
        feed.leave()
        feed.outbox = feed.subscription.outbox
        feed.paused = True

    def unpause(self, feed: PathSubscription) -> None:
        """Go on with the present value; what came meanwhile is not missed."""
        entry = feed.entry
        feed.paused = False
        feed.sent = entry.seq
        feed.outbox = feed.subscription.outbox
        if entry.path not in self.registry.entries:
            return
        if feed.subscription.outbox is None:
            self._keep_for(feed)
            return
        self._relink(feed)
        self._first(feed, entry.seq)

    def _keep_for(self, feed: PathSubscription) -> None:
        if not feed.kept:
            feed.kept = True
            self._keep(feed)

    def _unkeep_for(self, feed: PathSubscription) -> None:
        if feed.kept:
            feed.kept = False
            self._unkeep(feed)

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
        self._begin(subscription, self._detach_feeds(subscription))

    def _detach_feeds(self, subscription: Subscription) -> Work:
        for number, feed in enumerate(tuple(subscription.feeds.values()), 1):
            if subscription.outbox is not None:  # it is back already
                return
            self._detach_feed(feed)
            if not number % _STEP:
                yield

    def _detach_feed(self, feed: PathSubscription) -> None:
        if feed.outbox is None:
            return
        feed.leave()
        if feed.entry.path in self.registry.entries and not feed.paused:
            self._keep_for(feed)  # before the feed goes, so that its source goes on
        self.unlink(feed)

    def attach(
        self, subscription: Subscription, outbox: Outbox, missed_from: dict[str, int] | None
    ) -> None:
        """Go on sending, what was missed first; `missed_from` is what the client has, by path."""
        subscription.outbox = outbox
        self._begin(subscription, self._attach_feeds(subscription, outbox, missed_from or {}))

    def _attach_feeds(
        self, subscription: Subscription, outbox: Outbox, missed_from: dict[str, int]
    ) -> Work:
        for number, (path, feed) in enumerate(tuple(subscription.feeds.items()), 1):
            if subscription.outbox is not outbox:  # the client has gone again
                return
            if feed.outbox is not outbox and subscription.feeds.get(path) is feed:
                self._detach_feed(feed)  # where the turn for that has not come
                yield from self._attach_feed(feed, outbox, missed_from.get(path, feed.sent))
            if not number % _STEP:
                yield

    def _attach_feed(self, feed: PathSubscription, outbox: Outbox, known: int) -> Work:
        feed.outbox = outbox
        if feed.paused:
            return
        kept = feed.kept
        yield from self._replay(feed, known)
        if feed.outbox is not outbox or feed.paused or feed.kept is not kept:
            return
        if feed.entry.path in self.registry.entries:
            self._relink(feed)
        self._unkeep_for(feed)
        if feed.priority != 4:
            outbox.prioritised = True

    def _replay(self, feed: PathSubscription, known: int) -> Work:
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
                message=f"{lost} samples of {feed.entry.path} are not in the replay buffer any more",
            )
        outbox = feed.outbox
        samples = yield from admitted(feed, [sample for sample in ring if sample.seq > known])
        if feed.outbox is outbox:
            feed.replay(samples)

    def forget(self, subscription: Subscription) -> None:
        """Let go of a subscription whose session has ended."""
        self._begin(subscription, self.remove(subscription))

    def end(
        self,
        subscription: Subscription,
        leaving: Callable[[PathSubscription], None] | None,
        told: Callable[[], None],
    ) -> None:
        """End a subscription that has come to its end by itself; `told` is called afterwards."""
        removal = self.remove(subscription, leaving)

        def work() -> Work:
            yield from removal
            told()

        self._begin(subscription, work())

    def drop(self, feed: PathSubscription) -> None:
        """Take one path out of a subscription."""
        subscription = feed.subscription
        del subscription.feeds[feed.entry.path]
        self._unkeep_for(feed)
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
                if known.outbox is None:
                    if returned:
                        known.kept = False  # with the entry that has gone
                        self._keep_for(known)
                elif known not in path_subscriptions_of(entry):
                    self._relink(known)
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
