"""Linking of subscriptions to the tree, their detaching, resuming and ending, all in steps.

A subscription may have twenty thousand paths. Between steps, a client may disconnect, return or end
it, and the tree may change: each step uses the current state.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Iterator

from rcp_kernel.sessions.notices import notice
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_scheduling.turns import Turns, Work
from rcp_streams.hub import Hub
from rcp_streams.options import seconds
from rcp_streams.path_subscription import PathSubscription
from rcp_streams.selection import new_path_subscription
from rcp_streams.subscription import Subscription

__all__ = ["SubscriptionLinker"]

_STEP = 32  # paths linked or unlinked per step
_FILTERED = 16  # samples per step: filters and access rules take time for each of up to a thousand
_STREAMS = "streams"  # key, with an owner, of the work on its subscriptions
_LONGEST = 86_400.0 * 365  # s: maximum of a timer


class SubscriptionLinker:
    """Applies the hub's operations to all paths of a subscription."""

    def __init__(self, hub: Hub, turns: Turns) -> None:
        self._hub = hub
        self._turns = turns

    def add(self, subscription: Subscription, entries: list[Entry]) -> None:
        """Start a subscription on the entries that it matches now; later ones are added automatically.

        They are linked in steps, some of them before this returns.
        """
        self._start(subscription)
        subscription.awaited = {entry.path: entry.seq for entry in entries}
        self.begin(subscription, self._link_awaited(subscription))

    def search(self, subscription: Subscription, matches: Iterator[Entry]) -> None:
        """Start a subscription like `add`, on those of the matching entries that it may have, in steps."""
        self._start(subscription)
        self.begin(subscription, self._search(subscription, matches))

    def _start(self, subscription: Subscription) -> None:
        self._hub.subscriptions.add(subscription)
        duration = subscription.options.duration
        if duration is not None:
            subscription.timer = self._hub.loop.call_later(
                min(duration, _LONGEST), subscription.end, subscription, "duration", None
            )

    def begin(self, subscription: Subscription, work: Work) -> None:
        """Start work on a subscription, after all earlier work on it."""
        self.begin_for(subscription.owner, work)

    def begin_for(self, owner: Hashable, work: Work) -> None:
        """Start work on a client's subscriptions, after all earlier work on them."""
        self._turns.oblige((_STREAMS, owner), work)

    def _search(self, subscription: Subscription, matches: Iterator[Entry]) -> Work:
        for number, entry in enumerate(matches, 1):
            if subscription not in self._hub.subscriptions:  # it has ended
                return
            if entry.path not in subscription.feeds and subscription.may(entry):
                subscription.awaited[entry.path] = entry.seq
            if not number % _STEP:
                yield
        yield from self._link_awaited(subscription)

    def _link_awaited(self, subscription: Subscription) -> Work:
        awaited = subscription.awaited
        for number, path in enumerate(tuple(awaited), 1):
            if path in awaited:  # until it ends
                yield from self._link_path(subscription, path)
                awaited.pop(path, None)
            if not number % _STEP:
                yield

    def _link_path(self, subscription: Subscription, path: str) -> Work:
        entry = self._hub.registry.entries.get(path)
        if entry is None or not subscription.may(entry):  # changed since the client was informed
            notice(subscription.outbox, "resource_removed", id=subscription.id, path=path)
            return
        feed = new_path_subscription(subscription, entry)
        history, last = subscription.options.history, subscription.awaited[path]
        samples: list[Sample] = []
        if history:
            samples = yield from _admitted(feed, _past(feed, history, last))
            if path not in subscription.awaited:
                return
            if self._hub.registry.entries.get(path) is not entry:  # replaced or removed
                yield from self._link_path(subscription, path)
                return
        self._hub.link(subscription, feed)
        if feed.paused:
            return
        if history:
            feed.replay(samples)
        else:
            self._hub.first(feed, last)

    def remove(
        self, subscription: Subscription, leaving: Callable[[PathSubscription], None] | None = None
    ) -> Work:
        """End a subscription in steps; `leaving` is called with each feed before it is unlinked.

        Its queued samples are dropped. It may still send until the last step.
        """
        self._hub.subscriptions.discard(subscription)
        self._hub.dropped["conflated"] += subscription.skipped
        subscription.skipped = 0
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
                self._hub.let_go(feed)
            if not number % _STEP:
                yield

    def detach(self, subscription: Subscription) -> None:
        """Stop sending because the connection is lost; the history of its paths is still kept."""
        subscription.outbox = None
        self.begin(subscription, self._detach_feeds(subscription))

    def _detach_feeds(self, subscription: Subscription) -> Work:
        for number, feed in enumerate(tuple(subscription.feeds.values()), 1):
            if subscription.outbox is not None:  # already resumed
                return
            self._detach_feed(feed)
            if not number % _STEP:
                yield

    def _detach_feed(self, feed: PathSubscription) -> None:
        if feed.outbox is None:
            return
        feed.leave()
        if feed.entry.path in self._hub.registry.entries and not feed.paused:
            self._hub.retain(feed)  # before the feed is unlinked, so that its source keeps running
        self._hub.unlink(feed)

    def attach(
        self, subscription: Subscription, outbox: Outbox, missed_from: dict[str, int] | None
    ) -> None:
        """Resume sending, missed samples first; `missed_from` is the client's last sample by path."""
        subscription.outbox = outbox
        self.begin(subscription, self._attach_feeds(subscription, outbox, missed_from or {}))

    def _attach_feeds(
        self, subscription: Subscription, outbox: Outbox, missed_from: dict[str, int]
    ) -> Work:
        for number, (path, feed) in enumerate(tuple(subscription.feeds.items()), 1):
            if subscription.outbox is not outbox:  # disconnected again
                return
            if feed.outbox is not outbox and subscription.feeds.get(path) is feed:
                self._detach_feed(feed)  # not linked yet
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
        if feed.entry.path in self._hub.registry.entries:
            self._hub.relink(feed)
        self._hub.release(feed)
        if feed.priority != 4:
            outbox.prioritised = True

    def _replay(self, feed: PathSubscription, known: int) -> Work:
        ring = feed.entry.ring
        if feed.entry.seq <= known or feed.remote:
            return  # a remote one reports its own gaps
        oldest = ring[0].seq if ring else feed.entry.seq + 1
        if oldest > known + 1:
            lost = oldest - known - 1
            self._hub.dropped["gap"] += lost
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
        outbox = feed.outbox
        samples = yield from _admitted(feed, [sample for sample in ring if sample.seq > known])
        if feed.outbox is outbox:
            feed.replay(samples)

    def forget(self, subscription: Subscription) -> None:
        """Remove a subscription whose session has ended."""
        self.begin(subscription, self.remove(subscription))

    def end(
        self,
        subscription: Subscription,
        leaving: Callable[[PathSubscription], None] | None,
        ended: Callable[[], None],
    ) -> None:
        """Remove a subscription that has ended by itself; `ended` is called afterwards."""
        removal = self.remove(subscription, leaving)

        def work() -> Work:
            yield from removal
            ended()

        self.begin(subscription, work())


def _past(feed: PathSubscription, history: int | str, last: int) -> list[Sample]:
    """Return the samples that `history` selects, oldest first, and all after number `last`."""
    ring = list(feed.entry.ring)
    if isinstance(history, int):
        newer = sum(sample.seq > last for sample in ring)
        return ring[-history - newer :] if history + newer else []
    since = feed.entry.clock.now() - int(seconds(history) * 1e9)
    return [sample for sample in ring if sample.received >= since or sample.seq > last]


def _admitted(feed: PathSubscription, samples: list[Sample]) -> Generator[None, None, list[Sample]]:
    """Return those of `samples`, and of samples published meanwhile, that pass a feed's filters."""
    if not feed.judges:
        return samples
    passed: list[Sample] = []
    while samples:
        for number, sample in enumerate(samples, 1):
            if (admitted := feed.admit(sample)) is not None:
                passed.append(admitted)
            if not number % _FILTERED:
                yield
        last = samples[-1].seq
        samples = [sample for sample in feed.entry.ring if sample.seq > last]
    return passed
