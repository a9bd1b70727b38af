"""The hub keeps subscriptions linked to the tree as both change.

It links feeds to entries, and replays what a client missed.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcp_kernel.clients.mailbox import Mailbox, Ticker
from rcp_kernel.registry import Entry, Listener, Registry
from rcp_kernel.streaming.chorus import ChorusFeed, feeds_of, join, part
from rcp_kernel.streaming.feeds import Feed
from rcp_kernel.streaming.notices import notice
from rcp_kernel.streaming.samples import Sample
from rcp_kernel.streaming.silence import Silence
from rcp_kernel.streaming.streams import Subscription
from rcp_kernel.streaming.watches import Keeper, Watches, keeper_of
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
        self.ticker = Ticker(loop)
        self.subscriptions: set[Subscription] = set()
        self.dropped: dict[str, int] = {"conflated": 0, "overrun": 0, "gap": 0}
        self._timers = Timers(loop)
        self.later = self._timers.later
        self.silence = Silence(registry, loop)
        self.watches = Watches(registry, loop, self.later)
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

    def _first(self, feed: Feed, sample: Sample) -> None:
        if not feed.subscription.options.initial:
            feed.prime(sample)
        elif feed.admit(sample):
            feed.replay((sample,))
        if self.silence.known(feed.entry):
            self.silence.tell(feed)

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

    def _link(self, subscription: Subscription, entry: Entry) -> Feed:
        feed = subscription.feed(entry)
        subscription.feeds[entry.path] = feed
        if subscription.mailbox is None:
            self._keep(feed)
        else:
            self._relink(feed)
            if feed.priority != 4:
                subscription.mailbox.prioritised = True
        subscription.placed(feed)
        return feed

    def join(self, subscription: Subscription, entry: Entry) -> None:
        """Add an entry to a subscription that stands, and tell its client."""
        feed = self._link(subscription, entry)
        notice(subscription.mailbox, "resource_added", id=subscription.id, path=entry.path)
        if entry.latest is not None and not feed.paused:
            self._first(feed, entry.latest)

    def pause(self, feed: Feed) -> None:
        """Send nothing more of a path for now; what waits is forgotten."""
        if feed.subscription.mailbox is None:
            self._unkeep(feed)
        self.unlink(feed)
        feed.leave()
        feed.mailbox = feed.subscription.mailbox
        feed.paused = True

    def unpause(self, feed: Feed) -> None:
        """Go on with the present value; what came meanwhile is not missed."""
        entry = feed.entry
        feed.paused = False
        feed.sent = entry.seq
        if entry.path not in self.registry.entries:
            return
        if feed.subscription.mailbox is None:
            self._keep(feed)
            return
        self._relink(feed)
        if entry.latest is not None:
            self._first(feed, entry.latest)

    def _keep(self, feed: Feed) -> None:
        """Have the history of a path kept for a client that is away."""
        entry = feed.entry
        entry.listeners.append(keeper_of(feed))
        if len(entry.listeners) == 1:
            entry.size_ring()
        self.watches.retune(entry)

    def _relink(self, feed: Feed) -> None:
        entry = feed.entry
        if isinstance(feed, ChorusFeed):
            join(feed, entry)
        else:
            entry.listeners.append(feed)
        if len(entry.listeners) == 1:
            entry.size_ring()
        feed.heard = time.monotonic()
        if entry.deadline is not None or feed.subscription.options.qos.deadline is not None:
            self.silence.follow(entry)
        self.watches.retune(entry)

    def unlink(self, feed: Feed) -> None:
        """Offer a feed nothing more."""
        if self._cut(feed):
            self._left(feed.entry)

    def _left(self, entry: Entry) -> None:
        if not entry.listeners:
            self.silence.forget(entry)
            entry.size_ring()
        self.watches.retune(entry)

    @staticmethod
    def _cut(feed: Feed) -> bool:
        """Take a feed from its entry's listeners; tell whether it was among them."""
        if isinstance(feed, ChorusFeed):
            return part(feed, feed.entry)
        entry = feed.entry
        if feed not in entry.listeners:
            return False
        # A new list: the old one may be the one that a sample is being offered to right now.
        entry.listeners = [listener for listener in entry.listeners if listener is not feed]
        return True

    @staticmethod
    def plain_feed(subscription: Subscription, entry: Entry, mailbox: Mailbox | None) -> Feed:
        """Make the feed of a subscription that wants every sample as it comes."""
        options = subscription.options
        alone = options.qos.reliability == "reliable" or (mailbox is not None and mailbox.alone)
        kind = Feed if alone or options.count is not None else ChorusFeed
        return kind(subscription, entry, mailbox)

    @staticmethod
    def keep(entry: Entry) -> None:
        """Have the whole history of a path kept although nobody may be listening."""
        entry.listeners.append(Keeper(0.0))
        entry.size_ring()

    def listen(self, entry: Entry, listener: Listener) -> None:
        """Offer the gateway's own listener every sample, and keep the source running for it."""
        if listener not in entry.listeners:
            entry.listeners.append(listener)
            if len(entry.listeners) == 1:
                entry.size_ring()
        self.watches.retune(entry)

    def unlisten(self, entry: Entry, listener: Listener) -> None:
        """Offer a listener nothing more."""
        if listener in entry.listeners:
            entry.listeners = [known for known in entry.listeners if known is not listener]
            self._left(entry)

    # -- cut and resume ------------------------------------------------------------------------

    def detach(self, subscription: Subscription) -> None:
        """Stop sending: the connection is gone. The history of its paths goes on being kept."""
        subscription.mailbox = None
        for path, feed in subscription.feeds.items():
            feed.leave()
            if path in self.registry.entries and not feed.paused:
                self._keep(feed)  # before the feed goes, so that its source goes on
            self.unlink(feed)

    def attach(
        self, subscription: Subscription, mailbox: Mailbox, missed_from: dict[str, int] | None
    ) -> None:
        """Go on sending, what was missed first; `missed_from` is what the client has, by path."""
        subscription.mailbox = mailbox
        for path, feed in subscription.feeds.items():
            feed.mailbox = mailbox
            if feed.paused:
                continue
            known = feed.sent if missed_from is None else missed_from.get(path, feed.sent)
            self._replay(feed, known)
            if path in self.registry.entries:
                self._relink(feed)
            self._unkeep(feed)
            if feed.priority != 4:
                mailbox.prioritised = True

    def _replay(self, feed: Feed, known: int) -> None:
        ring = feed.entry.ring
        if feed.entry.seq <= known:
            return
        oldest = ring[0].seq if ring else feed.entry.seq + 1
        if oldest > known + 1:
            lost = oldest - known - 1
            self.dropped["gap"] += lost
            notice(
                feed.mailbox,
                "gap",
                id=feed.subscription.id,
                path=feed.entry.path,
                lost=lost,
                first=known + 1,
                last=oldest - 1,
                message=f"{lost} samples of {feed.entry.path} are not in the replay buffer any more",
            )
        feed.replay([s for s in ring if s.seq > known and feed.admit(s)])

    def forget(self, subscription: Subscription) -> None:
        """Let go of a detached subscription whose session has expired."""
        if subscription.mailbox is None:
            for feed in subscription.feeds.values():
                self._unkeep(feed)
        self.remove(subscription)

    def drop(self, feed: Feed) -> None:
        """Take one path out of a subscription."""
        subscription = feed.subscription
        del subscription.feeds[feed.entry.path]
        if subscription.mailbox is None:
            self._unkeep(feed)
        self.unlink(feed)
        feed.leave()

    def _unkeep(self, feed: Feed) -> None:
        entry, keeper = feed.entry, keeper_of(feed)
        if keeper in entry.listeners:
            entry.listeners.remove(keeper)
            self._left(entry)

    def sustain(self, entry: Entry, rate: float) -> None:
        """Have an entry published at `rate` Hz at least, whoever listens; 0.0: no more."""
        if entry.sustained != rate:
            entry.sustained = rate
            self.watches.retune(entry)

    # -- the tree changes ----------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        for subscription in list(self.subscriptions):
            known = subscription.feeds.get(entry.path)
            if known is not None:
                returned = known.entry is not entry and known.entry.listeners is not entry.listeners
                known.entry = entry
                if known.paused:
                    continue
                if subscription.mailbox is None:
                    if returned:
                        self._keep(known)
                elif known not in feeds_of(entry):
                    self._relink(known)
                    notice(
                        subscription.mailbox, "resource_added", id=subscription.id, path=entry.path
                    )
            elif subscription.wants(entry):
                self.join(subscription, entry)
        if entry.listeners:
            if entry.deadline is not None:
                self.silence.follow(entry)
            self.watches.retune(entry)

    def _removed(self, entry: Entry) -> None:
        for feed in list(feeds_of(entry)):
            if self._cut(feed):
                subscription = feed.subscription
                notice(
                    subscription.mailbox, "resource_removed", id=subscription.id, path=entry.path
                )
        self.silence.forget(entry)
        entry.listeners = []
        entry.sustained = 0.0
        self.watches.retune(entry)

    async def close(self) -> None:
        """Leave every watch and stop the timers."""
        self._timers.close()
        self.silence.close()
        await self.watches.close()
