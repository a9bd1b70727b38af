"""Whole messages over a pair of keys: numbered, so that a loss is found, and limited in flight.

Zenoh keeps the order of one key and priority, but what is on the way when a connection breaks is
lost without a word, and a full queue drops. A missing number therefore ends the link, and the
session is resumed on a new one. Zenoh does not tell when the other end is slow, so that the
receiver acknowledges bytes, and the sender stops at a window for each priority class. Heartbeats
repeat the last number of each class, so that the loss of a last message is found, and their absence
tells that the link is frozen.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import NamedTuple, Protocol

import zenoh

from rcp_zenoh.budget import Allowance
from rcp_zenoh.lane import WHOLE, Lane, Priority
from rcp_zenoh.path import Beat, PathTimes

__all__ = ["Message", "Pipe", "PipeOwner", "refuse"]

_HEAD = struct.Struct("<cBQ")
_MESSAGE, _PART, _LAST, _TAKEN, _BEAT, _END = b"m", b"p", b"n", b"a", b"h", b"e"
_WORDS = 200  # bytes that the other end may say about why it closed the link
_OVERHEAD = 64  # bytes of a message on the wire besides its data, in round figures
_DATA = frozenset((_MESSAGE, _PART))
_PRIORITIES = tuple(Priority)


class Message(NamedTuple):
    """A message of the other end."""

    data: bytes | None
    """None: it was longer than `longest`."""
    size: int
    priority: Priority


class PipeOwner(Protocol):
    """Who uses one end of a pipe."""

    @property
    def longest(self) -> int:
        """Longest message that is received."""
        ...

    def drained(self) -> None:
        """There is room again: send what waits."""
        ...

    def ended(self, why: str) -> None:
        """The link has ended."""
        ...


def refuse(session: zenoh.Session, key: str, why: str) -> None:
    """Tell another end why it gets no link."""
    attachment = _HEAD.pack(_END, Priority.CONTROL, 0)
    Lane(session, key, Priority.CONTROL).put(why.encode(), attachment)


def _reason(told: bytes) -> str:
    closed = "the other end closed the link"
    return f"{closed}: {told[:_WORDS].decode(errors='replace')}" if told else closed


class Pipe:
    """One end of a link; for the event loop's thread."""

    __slots__ = (
        "_allowance",
        "_alone_since",
        "_due",
        "_heard",
        "_idle",
        "_lanes",
        "_loop",
        "_owner",
        "_peer_idle",
        "_silence",
        "_timer",
        "closed",
        "heard",
        "lost",
        "on_beat",
        "reading",
        "times",
    )

    def __init__(
        self,
        session: zenoh.Session,
        key: zenoh.KeyExpr | str,
        silence: float,
        owner: PipeOwner,
        allowance: Allowance,
        on_beat: Callable[[], object] | None = None,
    ) -> None:
        """Open an end that sends on `key`, and ends after a `silence` of so many seconds.

        `key` is a declared one, or a text until `declare` is called. `on_beat` is called after each heartbeat.
        """
        self._owner, self._silence, self.on_beat = owner, silence, on_beat
        self._allowance = allowance
        self._lanes = tuple(Lane(session, key, one) for one in Priority)
        self.times = PathTimes()
        self.reading = True
        """Whether what is received is acknowledged; else the other end stops at its window."""
        self.closed = self.lost = False
        self._loop = asyncio.get_running_loop()
        self._heard = self._alone_since = self._loop.time()
        self.heard: float | None = None
        """When something was last received, by the clock of the event loop."""
        self._peer_idle = self._idle = False
        self._due = 0.0
        self._timer = self._schedule()

    # -- state ---------------------------------------------------------------------------------

    @property
    def buffered(self) -> int:
        """Bytes that the other end has not acknowledged."""
        return sum(lane.buffered for lane in self._lanes)

    @property
    def parked(self) -> int:
        """Bytes of long messages that wait for room."""
        return sum(len(part) for part, _ in self._lanes[Priority.BULK].parts)

    @property
    def written(self) -> int:
        """Bytes sent so far."""
        return sum(lane.written for lane in self._lanes)

    @property
    def received(self) -> int:
        """Bytes received so far."""
        return sum(lane.received for lane in self._lanes)

    @property
    def greeted(self) -> bool:
        """Whether the other end has taken a message."""
        return self._lanes[Priority.CONTROL].taken > 0

    def writable(self, priority: Priority) -> bool:
        """Whether there is room in the window of a class."""
        lane = self._lanes[priority]
        return not self.closed and lane.room > 0 and not lane.parts

    # -- sending -------------------------------------------------------------------------------

    def declare(self, key: zenoh.KeyExpr) -> None:
        """Send on the same key from now on, which is declared now: that costs less."""
        for lane in self._lanes:
            lane.key = key

    def send(self, data: bytes, priority: Priority) -> None:
        """Send one message, in parts if it is long; the caller heeds `writable`."""
        if self.closed:
            return
        if len(data) > WHOLE or priority is Priority.BULK:
            self._lanes[Priority.BULK].cut(data, self._allowance.part)
            self.pump()
        else:
            self._put(priority, _MESSAGE, data)

    def pump(self) -> None:
        """Send parts of long messages, as far as window and budget allow."""
        lane = self._lanes[Priority.BULK]
        while lane.parts and lane.room > 0 and self._allowance.left > 0 and not self.closed:
            part, last = lane.parts.popleft()
            self._put(Priority.BULK, _MESSAGE if last else _PART, part)

    def _put(self, priority: Priority, kind: bytes, data: bytes) -> None:
        lane = self._lanes[priority]
        if not self._unacknowledged:
            self._alone_since = self._loop.time()
        lane.count(len(data))
        if priority is not Priority.STOP:
            self._allowance.spend(len(data) + _OVERHEAD)
        lane.put(data, _HEAD.pack(kind, priority, lane.sent))
        self._wake()

    @property
    def _unacknowledged(self) -> bool:
        return any(lane.taken < lane.written for lane in self._lanes)

    def _tell(self, kind: bytes, priority: Priority, number: int, data: bytes = b"") -> None:
        self._lanes[Priority.CONTROL].put(data, _HEAD.pack(kind, priority, number))

    def acknowledge(self) -> None:
        """Tell the other end what was received, where it may wait for that."""
        if self.closed or not self.reading:
            return
        for priority, lane in zip(Priority, self._lanes, strict=True):
            if lane.due:
                lane.acknowledged = lane.received
                self._tell(_TAKEN, priority, lane.received)

    # -- receiving -----------------------------------------------------------------------------

    def receive(self, sample: zenoh.Sample) -> Message | None:
        """Return the message that a sample completes, if any; a missing number ends the link."""
        if self.closed:
            return None
        attachment = sample.attachment
        raw = b"" if attachment is None else attachment.to_bytes()
        if len(raw) < _HEAD.size or raw[1] >= len(self._lanes):
            self.end("the other end sent something that is not a message")
            return None
        kind, place, number = _HEAD.unpack_from(raw)
        self._heard = self.heard = self._loop.time()
        priority = _PRIORITIES[place]
        if kind in _DATA:
            return self._message(sample, kind, priority, number)
        if kind == _TAKEN:
            self._take({priority: number})
        elif kind == _LAST:
            self._check(priority, number)
        elif kind == _BEAT:
            self._beat(sample.payload.to_bytes())
        elif kind == _END:
            self.end(_reason(sample.payload.to_bytes()), tell=False)
        return None  # of a later version, if it is of none of these kinds

    def _message(
        self, sample: zenoh.Sample, kind: bytes, priority: Priority, number: int
    ) -> Message | None:
        lane = self._lanes[priority]
        if number != lane.seen + 1 and not self._check(priority, number - 1):
            return None
        lane.seen = number
        data = sample.payload.to_bytes()
        size = len(data)
        lane.received += size
        self._peer_idle = False
        if self._idle:
            self._wake()
        if lane.due:
            self.acknowledge()
        longest = self._owner.longest
        if kind == _MESSAGE and size <= longest and not lane.joining:  # as nearly all are
            return Message(data, size, priority)
        whole = lane.join(data, longest, last=kind == _MESSAGE)
        return None if whole is None else Message(*whole, priority)

    def _check(self, priority: Priority, last: int) -> bool:
        """End the link unless the last message of a class has this number."""
        seen = self._lanes[priority].seen
        if last != seen:
            self.lost = True
            self.end(f"messages {seen + 1} to {last} were lost on the way")
        return last == seen

    def _take(self, taken: dict[Priority, int]) -> None:
        grown = [self._lanes[priority].take(number) for priority, number in taken.items()]
        if any(grown):
            self._alone_since = self._loop.time()
            self.pump()
            self._owner.drained()

    def _beat(self, data: bytes) -> None:
        beat = Beat.read(data)
        if beat is None:
            self.end("the other end sent something that is not a heartbeat")
            return
        self.times.note(beat)
        self._peer_idle = beat.idle
        self._take(dict(zip(Priority, beat.taken, strict=True)))

    # -- heartbeats ----------------------------------------------------------------------------

    def _schedule(self) -> asyncio.TimerHandle:
        self._due = self._loop.time() + (self._silence if self._idle else self._silence / 3)
        return self._loop.call_at(self._due, self._tick)

    def _wake(self) -> None:
        """Send heartbeats more often: something is unacknowledged."""
        if self._idle:
            self._idle = False
            self._timer.cancel()
            self._timer = self._schedule()

    def _tick(self) -> None:
        moment = self._loop.time()
        if moment - self._due > self._silence / 3:
            self._heard = self._alone_since = moment  # this process was held up, not the link
        quiet = moment - self._heard
        alone = moment - max(self._heard, self._alone_since) if self._unacknowledged else 0.0
        patience = self._silence * (2 if self._peer_idle else 1)
        if quiet > patience or alone > self._silence:
            self.end(f"nothing received for {max(quiet, alone):.1f} s")
            return
        self._say_all()
        self._timer = self._schedule()
        if self.on_beat is not None:
            self.on_beat()

    def _say_all(self) -> None:
        """Send the last number of each class on its own way, and what was received."""
        for priority, lane in zip(Priority, self._lanes, strict=True):
            if self.reading:
                lane.acknowledged = lane.received
            if lane.taken < lane.written:
                lane.put(b"", _HEAD.pack(_LAST, priority, lane.sent))
        unsaid = any(lane.acknowledged < lane.received for lane in self._lanes)
        self._idle = not (self._unacknowledged or unsaid)
        taken = tuple(lane.acknowledged for lane in self._lanes)
        self._tell(_BEAT, Priority.CONTROL, 0, self.times.beat(taken, idle=self._idle).write())

    def end(self, why: str, *, tell: bool = True) -> None:
        """End the link, once."""
        if self.closed:
            return
        self.closed = True
        self._timer.cancel()
        if tell:
            self._tell(_END, Priority.CONTROL, 0, why.encode())
        for lane in self._lanes:
            lane.close()
        self._owner.ended(why)
