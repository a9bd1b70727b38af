"""The outbox of one client: replies and notices in order, updates as fresh as the socket allows.

A slow client delays nobody else. Updates queue in their path subscriptions, bounded, and conflate;
replies are counted in bytes, and the gateway stops reading from a client that leaves too many unread. Data for
the sockets is collected once per loop iteration, for all outboxes in one tick, so that a burst
becomes one write.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Container
from time import perf_counter
from typing import Any, Protocol

import structlog

from rcp_kernel.sessions.outbound import SHARE, Backlog
from rcp_kernel.tree.samples import Rendering, Sample
from rcp_kernel.values import Encoding

__all__ = [
    "BUDGET",
    "TICK",
    "Direct",
    "FlushScheduler",
    "Framing",
    "Outbox",
    "PendingPath",
    "Translator",
    "Wrap",
]

log = structlog.get_logger("rcp.streams")
BUDGET = 262_144  # bytes that an outbox sends at once
_PATIENCE = 0.001  # s of collecting samples of many paths, before others have their turn
TICK = 0.004  # s of one tick: the other outboxes wait for the next loop iteration
_FEW = 32  # paths collected between checks of the time

Framing = Callable[[int, bool], bytes]
"""Makes the head of a transport's frame, from the message's length and whether it is text."""

Direct = Callable[[list[bytes]], int | None]
"""Sends frames at once; returns how many bytes are unread since, or None if there was no room."""

Wrap = Callable[[bytes, Sample | None], bytes]
"""Frames one message for its transport: an update with its sample, or a control message."""


class PendingPath(Protocol):
    """A path of a subscription with updates to collect."""

    marked: bool
    queue: deque[Sample]
    backlog: deque[Sample] | None

    @property
    def priority(self) -> int:
        """Higher priorities are collected first."""
        ...

    @property
    def depth(self) -> int:
        """Maximum number of queued samples."""
        ...

    @property
    def waiting(self) -> int:
        """Number of queued samples."""
        ...

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move queued samples to `out` as framed updates; return their number of bytes."""
        ...

    def queued_bytes(self) -> int:
        """Estimate the number of queued bytes."""
        ...

    def shed(self, known: Container[str], reason: str) -> None:
        """Conflate, or end a reliable subscription whose id is `known`, for a reason."""
        ...


class Translator(Protocol):
    """An adapter's words for what a client is told besides its updates."""

    def notice(self, code: str, facts: dict[str, Any]) -> None:
        """Handle a notice, with the fields that it has on the wire."""
        ...

    def skipped(self, subscription: str, path: str, count: int) -> None:
        """Take note of samples skipped before the next update: the client was too slow for them."""
        ...


class Flushable(Protocol):
    """Anything that a tick can flush."""

    dirty: bool
    """Whether the next tick will flush it; the tick resets this first."""

    @property
    def on_flush(self) -> Callable[[], None] | None:
        """Called by the tick."""
        ...


class FlushScheduler:
    """One callback per loop iteration for everything that has data to send."""

    __slots__ = ("_dirty", "_gathering", "_loop")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._dirty: list[Flushable] = []
        self._gathering = False

    def mark(self, one: Flushable) -> None:
        """Flush an outbox or fan-out in the next tick; it must not be marked already."""
        if not self._dirty and not self._gathering:
            self._loop.call_soon(self._tick)
        self._dirty.append(one)

    def later(self, seconds: float, function: Callable[[], None]) -> asyncio.TimerHandle:
        """Call a function in so many seconds."""
        return self._loop.call_later(seconds, function)

    def gather(self, function: Callable[..., object], *args: Any) -> None:
        """Call a function, then tick: what it has published is sent in the same loop iteration.

        If it has published nothing, the tick follows behind the tasks that it has woken.
        """
        if self._gathering or self._dirty:  # a tick is scheduled anyway
            function(*args)
            return
        self._gathering = True
        try:
            function(*args)
        finally:
            if self._dirty:
                self._tick()
            else:
                self._loop.call_soon(self._tick)

    def _tick(self) -> None:
        self._gathering = False
        dirty, self._dirty = self._dirty, []
        until = perf_counter() + TICK
        for place, one in enumerate(dirty):
            if place and perf_counter() > until:
                self._postpone(dirty[place:])
                return
            one.dirty = False
            flush = one.on_flush
            if flush is not None:
                try:
                    flush()
                except Exception:  # an error of one client must not affect the others
                    log.exception("flush_failed")

    def _postpone(self, left: list[Flushable]) -> None:
        """Continue in the next loop iteration, ahead of anything marked meanwhile."""
        if not self._dirty:
            self._loop.call_soon(self._tick)
        self._dirty[:0] = left


class Outbox:
    """Data to send on one connection; the transport collects it when its socket is writable."""

    __slots__ = (
        "_flush_scheduler",
        "alone",
        "backlog",
        "begins",
        "buffered",
        "control",
        "direct",
        "dirty",
        "encoding",
        "feedback",
        "framing",
        "high_water",
        "on_flush",
        "parked",
        "paused",
        "pending",
        "prioritised",
        "renderings",
        "takes_long",
        "text",
        "translator",
        "updates",
        "waiting",
    )

    def __init__(
        self,
        ticker: FlushScheduler,
        encoding: Encoding,
        flush: Callable[[], None],
        backlog: Backlog,
    ) -> None:
        self._flush_scheduler = ticker
        self.backlog = backlog
        """The count of this client's unread bytes."""
        self.on_flush: Callable[[], None] | None = flush
        """The transport's callback; None once it is closed."""
        self.encoding = encoding
        self.text = encoding is Encoding.JSON
        self.dirty = False
        """Whether a tick follows; a transport sets it during a read, to send the replies itself."""
        self.begins = False
        """Whether the last reply of a command says that it was accepted: more may follow in this turn of
        the loop, so a transport that sends replies itself leaves them to the tick, and resets this."""
        self.framing: Framing | None = None
        """Frames for the transport, see `send_frames`."""
        self.direct: Direct | None = None
        self.alone = False
        """Wraps each message for this client only, so that frames cannot be shared."""
        self.takes_long = False
        """The client accepts messages of any length because of segmented transfer: long values are
        sent whole to its pattern subscriptions too."""
        self.control: list[bytes] = []
        """Replies and notices: in order, never dropped. Queue them by `put`, which counts them."""
        self.waiting = 0
        """Bytes of `control`."""
        self.parked = 0
        """Bytes of messages that the transport has collected and is sending in segments."""
        self.buffered = 0
        """Bytes that the transport has written and the client has not read."""
        self.feedback: dict[str, Callable[[], bytes]] = {}
        """The newest feedback of each running command, by command id."""
        self.pending: list[PendingPath] = []
        """Path subscriptions with queued samples."""
        self.paused = 0
        """Number of subscriptions being checked for paths that the client may no longer see: no
        update is collected meanwhile. Changed by `pause` and `resume`."""
        self.prioritised = False
        self.renderings: dict[str, Rendering] = {}
        """How updates are written, by the id of their subscription, see `render`."""
        self.translator: Translator | None = None
        """Has another protocol's words for what is not an update, see `translate`."""
        self.updates = 0
        self.high_water = 0

    def put(self, data: bytes) -> None:
        """Queue a control message."""
        self.control.append(data)
        self.waiting += len(data)
        if self.waiting > SHARE:
            self.update_backlog()
        if not self.dirty:
            self.dirty = True
            self._flush_scheduler.mark(self)

    def put_first(self, data: bytes) -> None:
        """Queue a control message ahead of all others."""
        self.control.insert(0, data)
        self.waiting += len(data)
        self.mark()

    def send_frames(self, framing: Framing, direct: Direct) -> None:
        """Collect frames, for a transport that frames whole messages.

        `collect` then returns bytes ready for the socket, a long message in two parts, and receivers
        of the same bytes share frames. If nothing else is queued, `direct` sends frames at once.
        """
        self.framing, self.direct, self.takes_long = framing, direct, False

    def translate(self, translator: Translator) -> None:
        """Have notices and skipped samples told in another protocol's words.

        What is queued by `put` is then text if it begins with `{`, else binary.
        """
        self.translator = translator

    def send_messages(self, *, long: bool = False) -> None:
        """Collect whole messages without frames (the default).

        `long`: the client accepts messages of any length, because of segmented transfer.
        """
        self.framing = self.direct = None
        self.takes_long = long

    def render(self, subscription: str, rendering: Rendering | None) -> None:
        """Write the updates of a subscription that is to be made in an adapter's own form.

        Its option `encoding` says whether they are text (`json`) or binary (`cbor`). None forgets it.
        """
        if rendering is None:
            self.renderings.pop(subscription, None)
        else:
            self.renderings[subscription] = rendering

    def hand(self, buffered: int) -> None:
        """Set the number of bytes that the transport has written and the client has not read."""
        if buffered != self.buffered:
            self.buffered = buffered
            self.update_backlog()

    def park(self, size: int) -> None:
        """Set the number of bytes that the transport sends in segments, or keeps to repeat them."""
        if size != self.parked:
            self.parked = size
            self.update_backlog()

    def update_backlog(self) -> None:
        """Update the backlog."""
        self.backlog.set(self.waiting + self.parked + self.buffered)

    @property
    def crowded(self) -> bool:
        """Whether reading from the client should pause because of its unread bytes."""
        return self.backlog.size > SHARE and self.backlog.crowded

    @property
    def more(self) -> bool:
        """Whether there is data to collect."""
        return bool(self.control or self.feedback or (self.pending and not self.paused))

    def pause(self) -> None:
        """Collect no updates until `resume`; they stay queued, and conflate."""
        self.paused += 1

    def resume(self) -> None:
        """Collect updates again after the last `pause` has ended."""
        self.paused -= 1
        if not self.paused and self.pending:
            self.mark()

    def again(self) -> None:
        """Call the transport again for the rest, as soon as there is room."""
        if not (self.control or self.feedback) and self.pending and self.backlog.full:
            self.backlog.wait(self)
        elif self.more:
            self.mark()

    def mark(self) -> None:
        """Call the transport in the next tick."""
        if not self.dirty:
            self.dirty = True
            self._flush_scheduler.mark(self)

    def flush(self) -> None:
        """Call the transport, which collects if its socket is writable."""
        if self.on_flush is not None:
            self.on_flush()

    def close(self) -> None:
        """Drop everything; the transport is closed."""
        self.on_flush = self.direct = None
        self.control.clear()
        self.feedback.clear()
        self.pending.clear()
        self.waiting = self.parked = self.buffered = 0
        self.backlog.close(self)

    @property
    def depth(self) -> int:
        """Number of queued messages."""
        return len(self.control) + len(self.feedback) + sum(feed.waiting for feed in self.pending)

    def collect(
        self,
        budget: int = BUDGET,
        *,
        wrap: Wrap | None = None,
        big: int | None = None,
    ) -> list[bytes]:
        """Return the data to send now: control messages first, then updates by priority.

        Stops after about `budget` bytes; the rest stays queued, and the transport collects again
        when the socket has room (`more`). With `big`, longer updates stay queued, for a transport
        that is still busy with an earlier one.
        """
        long = self.waiting > SHARE
        if self.waiting <= budget:
            out = self.control
            self.control = []
            self.waiting = 0
        else:
            out = self._take(budget)
        room = budget
        while self.feedback and not self.control and room > 0:
            data = self.feedback.pop(next(iter(self.feedback)))()
            room -= len(data)
            out.append(data)
        if self.backlog.size:
            self.update_backlog()
        if out and wrap is not None:
            out = [wrap(data, None) for data in out]
        elif out and self.framing is not None:
            text = self.text
            frame = self.framing
            if self.translator is not None:
                out = [part for data in out for part in (frame(len(data), data[:1] == b"{"), data)]
            elif long:  # the head is a separate part, so that a long body is not copied
                out = [part for data in out for part in (frame(len(data), text), data)]
            else:
                head, size = b"", -1
                for place, data in enumerate(out):
                    if len(data) != size:  # replies to alike requests are often equally long
                        size = len(data)
                        head = frame(size, text)
                    out[place] = head + data
        pending = self.pending
        if not pending or self.control or self.feedback or self.paused:
            return out
        if big is None and self.backlog.full:
            big = SHARE  # long updates stay queued, and conflate, until other clients have had their turn
        later: list[PendingPath] = []
        self.pending = later
        if self.prioritised:
            pending.sort(key=_urgency)
        if len(pending) > self.high_water:  # noqa: PLR1730 - a call less for each update
            self.high_water = len(pending)
        until = perf_counter() + _PATIENCE if len(pending) > _FEW else 0.0
        for place, feed in enumerate(pending, 1):
            budget -= feed.drain(out, budget, wrap, big)
            if feed.queue or feed.backlog:
                later.append(feed)
            else:
                feed.marked = False
            if budget <= 0 or (not place % _FEW and perf_counter() > until):
                later.extend(pending[place:])
                break
        return out

    def _take(self, budget: int) -> list[bytes]:
        """Remove the first control messages, at least one, up to about `budget` bytes."""
        size = count = 0
        for data in self.control:
            size += len(data)
            count += 1
            if size >= budget:
                break
        out = self.control[:count]
        del self.control[:count]
        self.waiting -= size
        return out


def _urgency(feed: PendingPath) -> int:
    return -feed.priority
