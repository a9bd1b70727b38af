"""The hub keeps subscriptions linked to the tree as both change, and sources running while wanted.

It links feeds to entries, replays what a client missed, tells of stale values, and enters and
leaves `Backend.watch` with the rate that the most demanding subscriber wants.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any

import structlog

from rcp_kernel.chorus import ChorusFeed, feeds_of, join, part
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import RcpError
from rcp_kernel.feeds import Feed
from rcp_kernel.mailbox import Mailbox, Ticker
from rcp_kernel.registry import Entry, Listener, Registry
from rcp_kernel.samples import Sample
from rcp_kernel.spi import BaseBackend
from rcp_kernel.streams import Subscription
from rcp_kernel.wire import encode_frame

__all__ = ["Hub", "notice"]

log = structlog.get_logger("rcp.streams")
_SWEEP = 0.1  # s between looks for values that went stale
_WATCH_RETRY = 1.0  # s until a watch that failed is entered again
_LONGEST = 86_400.0 * 365  # s: no timer reaches further


def notice(mailbox: Mailbox | None, code: str, **facts: Any) -> None:
    """Tell a client something it did not ask for; without a connection nobody is told."""
    if mailbox is None:
        return
    kept = {key: value for key, value in facts.items() if value is not None}
    fields = {"type": "notice", "code": code, **kept, "timestamp": iso(now())}
    mailbox.push(encode_frame(fields, b"", mailbox.encoding))


class Hub:
    """Every subscription of the gateway."""

    def __init__(self, registry: Registry, loop: asyncio.AbstractEventLoop) -> None:
        self.registry = registry
        self.loop = loop
        self.ticker = Ticker(loop)
        self.subscriptions: set[Subscription] = set()
        self.dropped: dict[str, int] = {"conflated": 0, "overrun": 0, "gap": 0}
        self._watches: dict[str, _Watch] = {}
        self._timed: dict[str, bool] = {}
        """Paths whose silence somebody is to be told of, with whether they are known stale."""
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._alarm: asyncio.TimerHandle | None = None
        self._sweep: asyncio.TimerHandle | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False
        registry.on_added.append(self._added)
        registry.on_removed.append(self._removed)

    def soon(self, function: Callable[..., object], *args: Any) -> None:
        """Call a function in the coming loop turn."""
        self.loop.call_soon(function, *args)

    def later(self, delay: float, function: Callable[[], None]) -> None:
        """Call a function after `delay` seconds; one timer serves all."""
        due = self.loop.time() + delay
        heapq.heappush(self._due, (due, next(self._count), function))
        if self._alarm is None or due < self._alarm.when():
            if self._alarm is not None:
                self._alarm.cancel()
            self._alarm = self.loop.call_at(due, self._ring)

    def _ring(self) -> None:
        self._alarm = None
        moment = self.loop.time() + 0.0005
        try:
            while self._due and self._due[0][0] <= moment:
                heapq.heappop(self._due)[2]()
        finally:  # one that raises must not silence the others
            if self._due and self._alarm is None:
                self._alarm = self.loop.call_at(self._due[0][0], self._ring)

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
        if self._timed.get(feed.entry.path):
            self._tell_stale(feed)

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
        entry.listeners.append(_keeper(feed))
        if len(entry.listeners) == 1:
            entry.size_ring()
        self._retune(entry)

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
            self._time(entry)
        self._retune(entry)

    def _time(self, entry: Entry) -> None:
        self._timed.setdefault(entry.path, entry.latest is not None and entry.stale)
        if self._sweep is None:
            self._sweep = self.loop.call_later(_SWEEP, self._look_for_stale)

    def unlink(self, feed: Feed) -> None:
        """Offer a feed nothing more."""
        if self._cut(feed):
            self._left(feed.entry)

    def _left(self, entry: Entry) -> None:
        if not entry.listeners:
            self._timed.pop(entry.path, None)
            entry.size_ring()
        self._retune(entry)

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
        alone = options.qos.reliability == "reliable" or options.encoding == "native"
        alone = alone or (mailbox is not None and mailbox.alone)
        kind = Feed if alone or options.count is not None else ChorusFeed
        return kind(subscription, entry, mailbox)

    @staticmethod
    def keep(entry: Entry) -> None:
        """Have the whole history of a path kept although nobody may be listening."""
        entry.listeners.append(_Keeper(0.0))
        entry.size_ring()

    def listen(self, entry: Entry, listener: Listener) -> None:
        """Offer the gateway's own listener every sample, and keep the source running for it."""
        if listener not in entry.listeners:
            entry.listeners.append(listener)
            if len(entry.listeners) == 1:
                entry.size_ring()
        self._retune(entry)

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
        entry, keeper = feed.entry, _keeper(feed)
        if keeper in entry.listeners:
            entry.listeners.remove(keeper)
            self._left(entry)

    def sustain(self, entry: Entry, rate: float) -> None:
        """Have an entry published at `rate` Hz at least, whoever listens; 0.0: no more."""
        if entry.sustained != rate:
            entry.sustained = rate
            self._retune(entry)

    def watches(self, entry: Entry) -> bool:
        """Tell whether the source of an entry is kept running."""
        return entry.path in self._watches

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
                self._time(entry)
            self._retune(entry)

    def _removed(self, entry: Entry) -> None:
        for feed in list(feeds_of(entry)):
            if self._cut(feed):
                subscription = feed.subscription
                notice(
                    subscription.mailbox, "resource_removed", id=subscription.id, path=entry.path
                )
        self._timed.pop(entry.path, None)
        entry.listeners = []
        entry.sustained = 0.0
        self._retune(entry)

    # -- sources -------------------------------------------------------------------------------

    def _retune(self, entry: Entry) -> None:
        backend = entry.owner.backend
        if backend is None or getattr(type(backend), "watch", None) is BaseBackend.watch:
            wanted: float | None = 0.0
        else:
            wanted = _wanted_rate(entry)
        watch = self._watches.get(entry.path)
        if watch is None:
            if wanted == 0.0:
                return
            watch = self._watches[entry.path] = _Watch(entry)
            task = self.loop.create_task(watch.run(), name=f"watch {entry.path}")
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            task.add_done_callback(lambda _: self._watch_ended(entry.path, watch))
        watch.want(entry, wanted)
        if wanted == 0.0:
            del self._watches[entry.path]

    def _watch_ended(self, path: str, watch: _Watch) -> None:
        """Enter a watch again that ended although it is wanted, after a while."""
        if not self._closed and self._watches.get(path) is watch:
            self.later(_WATCH_RETRY, lambda: self._rewatch(path, watch))

    def _rewatch(self, path: str, watch: _Watch) -> None:
        if self._watches.get(path) is watch:
            del self._watches[path]
            if (entry := self.registry.entries.get(path)) is not None:
                self._retune(entry)

    def backend_changed(self, entries: list[Entry]) -> None:
        """Watch again what a backend that came back has to publish; leave what it cannot any more."""
        for entry in entries:
            if (watch := self._watches.pop(entry.path, None)) is not None:
                watch.want(entry, 0.0)
            self._retune(entry)

    # -- silence -------------------------------------------------------------------------------

    def _look_for_stale(self) -> None:
        self._sweep = None
        moment = time.monotonic()
        for path, known in list(self._timed.items()):
            entry = self.registry.entries[path]
            stale = entry.latest is not None and entry.stale
            if stale is not known:
                self._timed[path] = stale
            for feed in feeds_of(entry):
                if stale and not known:
                    self._tell_stale(feed)
                self._check_deadline(feed, moment)
        if self._timed:
            self._sweep = self.loop.call_later(_SWEEP, self._look_for_stale)

    def _tell_stale(self, feed: Feed) -> None:
        age = feed.entry.age
        notice(
            feed.mailbox,
            "stale",
            id=feed.subscription.id,
            path=feed.entry.path,
            seq=feed.entry.seq,
            age=round(age, 3) if age is not None else None,
            message=f"{feed.entry.path} has sent nothing new within its deadline",
        )

    def _check_deadline(self, feed: Feed, moment: float) -> None:
        limit = feed.subscription.options.qos.deadline
        if limit is None:
            return
        age = feed.entry.age
        late = moment - feed.heard > limit and (age is None or age > limit)
        if late and not feed.missed:
            notice(
                feed.mailbox,
                "deadline_missed",
                id=feed.subscription.id,
                path=feed.entry.path,
                message=f"no update of {feed.entry.path} for {limit} s",
            )
        feed.missed = late

    async def close(self) -> None:
        """Leave every watch and stop the timers."""
        self._closed = True
        for timer in (self._alarm, self._sweep):
            if timer is not None:
                timer.cancel()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


@dataclass(frozen=True, slots=True)
class _Keeper:
    """Stands in for a feed whose client is away, so that history goes on being kept."""

    rate: float | None
    """What the client wants of the source, as it did while it was here."""

    def offer(self, sample: Sample) -> None:
        """Do nothing: the entry's ring has the sample."""


def _keeper(feed: Feed) -> _Keeper:
    return _Keeper(feed.subscription.options.rate)


def _wanted_rate(entry: Entry) -> float | None:
    """The most that anybody wants in Hz; None for everything, 0.0 for nothing at all."""
    best = entry.sustained
    for listener in entry.listeners:
        if isinstance(listener, _Keeper):
            rate = listener.rate
        else:
            rate = listener.subscription.options.rate if isinstance(listener, Feed) else None
        if rate is None:
            return None
        best = max(best, rate)
    return best


class _Watch:
    """One source kept running: enters the next `watch` before it leaves the last."""

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
