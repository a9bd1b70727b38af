"""One open python-can bus, with a reading and a writing thread.

Neither thread blocks the event loop. Received frames are handed to it in batches: while the loop is
busy, frames accumulate.
"""

from __future__ import annotations

import asyncio
import errno
import itertools
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from rcp_kernel.errors import AdapterUnavailable, QueueFull

if TYPE_CHECKING:
    import can

__all__ = ["Wire"]

_RECV = 0.1  # s a reader blocks at most, so that it notices the end
_SEND = 0.2  # s the interface may take to accept one frame
_FULL = 0.001  # s between two attempts while its own queue is full
_INBOX = 16_384  # frames queued for a busy event loop; older ones are dropped and counted
_FAILURES = 8  # consecutive failed sends after which the interface counts as lost
_ECHOES = 1024  # sent frames whose own echo is still expected


class _Waiting(NamedTuple):
    """Frames that wait to be sent, one after the other."""

    messages: Sequence[can.Message]
    expires: float
    """Monotonic time in s; 0: never, and no urgent frame outdates them."""
    number: int
    sender: Hashable


class Wire:
    """An open bus, until it is closed or `lost` is called once with the reason."""

    def __init__(
        self,
        bus: can.BusABC,
        *,
        name: str,
        queue: int,
        echoes: bool,
        received: Callable[[list[can.Message]], None],
        lost: Callable[[str], None],
    ) -> None:
        self.rx = self.tx = self.dropped = self.expired = self.failed = 0
        self.interface, self._limit = bus, queue
        self._received, self._lost = received, lost
        self._loop = asyncio.get_running_loop()
        self._inbox: deque[can.Message] = deque()
        self._outbox: deque[_Waiting] = deque()
        self._echoes: Counter[tuple[int, bytes]] | None = Counter() if echoes else None
        self._numbers = itertools.count(1)
        self._barriers: dict[Hashable, int] = {}
        self._moving = float("-inf")
        self._sending = False
        self._failures = 0
        """Consecutive failed sends."""
        self._wake = threading.Event()
        self._waiting = False
        self._closing = False
        self._threads = [
            threading.Thread(target=target, name=f"can {what} {name}", daemon=True)
            for target, what in ((self._read, "reader"), (self._write, "writer"))
        ]
        for thread in self._threads:
            thread.start()

    @property
    def waiting(self) -> int:
        """The number of entries that wait to be sent."""
        return len(self._outbox)

    @property
    def lag(self) -> float:
        """Seconds since the interface accepted a frame, while frames are queued."""
        return time.monotonic() - self._moving if self._sending or self._outbox else 0.0

    @property
    def refusing(self) -> bool:
        """Whether the interface has not accepted the frame that it was last given."""
        return self._sending or self._failures > 0

    def send(
        self,
        message: can.Message,
        *,
        lifetime: float | None,
        urgent: bool,
        sender: Hashable = None,
    ) -> None:
        """Queue a frame, as `send_together`."""
        self.send_together((message,), lifetime=lifetime, urgent=urgent, sender=sender)

    def send_together(
        self,
        messages: Sequence[can.Message],
        *,
        lifetime: float | None,
        urgent: bool,
        sender: Hashable = None,
    ) -> None:
        """Queue frames one after the other: all of them are sent, or none.

        `lifetime` is how long (s) they are worth sending; urgent frames go first.

        An urgent frame brings something to rest, so queued frames with a lifetime from the same
        sender are dropped. Those of other senders stay: stopping one motor must not silence its
        neighbours.

        :raises QueueFull: the queue is full; an urgent frame replaces the last one instead.
        :raises AdapterUnavailable: the wire is closed.
        """
        if self._closing:
            raise AdapterUnavailable("the CAN interface is closed")
        now = time.monotonic()
        if not self._outbox and not self._sending:
            self._moving = now
        expires = now + lifetime if lifetime is not None else 0.0
        number = next(self._numbers)
        if urgent:
            self._barriers[sender] = number
            if len(self._outbox) >= self._limit:
                self._outbox.pop()
                self.expired += 1
            self._outbox.appendleft(_Waiting(messages, expires, number, sender))
        elif len(self._outbox) >= self._limit:
            raise QueueFull(
                f"{self._limit} frames are already waiting: the bus accepts none",
                remedy="Check sensor/can/<bus>/state, and that another node acknowledges frames.",
            )
        else:
            self._outbox.append(_Waiting(messages, expires, number, sender))
        self._wake.set()

    async def close(self) -> None:
        """Send the queued frames as far as possible, and release the bus."""
        self._closing = True
        self._wake.set()
        await asyncio.get_running_loop().run_in_executor(None, self._end)

    def _end(self) -> None:
        for thread in reversed(self._threads):
            thread.join(2.0)
        with suppress(Exception):  # an interface that is gone cannot be closed cleanly
            self.interface.shutdown()

    # Threads

    def _read(self) -> None:
        recv, inbox = self.interface.recv, self._inbox
        while not self._closing:
            try:
                message = recv(_RECV)
            except Exception as error:
                self._report(f"receiving failed: {error}")
                return
            if message is None or self._is_echo(message):
                continue
            self.rx += 1
            if len(inbox) >= _INBOX:
                inbox.popleft()
                self.dropped += 1
            inbox.append(message)
            if not self._waiting:
                self._waiting = True
                self._soon(self._hand_over)

    def _hand_over(self) -> None:
        self._waiting = False
        inbox = self._inbox
        batch = [inbox.popleft() for _ in range(len(inbox))]
        if batch and not self._closing:
            self._received(batch)

    def _write(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            while self._outbox:
                waiting = self._outbox.popleft()
                if self._is_outdated(waiting):
                    continue
                self._sending = True
                try:
                    for place, message in enumerate(waiting.messages):
                        if not self._accepted(message, waiting if place == 0 else None):
                            break
                        self.tx, self._failures = self.tx + 1, 0
                        self._moving = time.monotonic()
                except Exception as error:
                    self.failed += 1
                    self._failures += 1
                    if self._closing:
                        return
                    if self._failures >= _FAILURES:
                        self._report(f"sending failed: {error}")
                        return
                finally:
                    self._sending = False
            if self._closing:
                return

    def _is_outdated(self, waiting: _Waiting) -> bool:
        """Return whether a later urgent frame, or time, has made something not worth sending."""
        if not waiting.expires:
            return False
        late = time.monotonic() > waiting.expires
        replaced = waiting.number < self._barriers.get(waiting.sender, 0)
        self.expired += late and not replaced
        return late or replaced

    def _accepted(self, message: can.Message, waiting: _Waiting | None) -> bool:
        """Have the interface accept a frame; return whether it was still worth sending.

        The first of several is looked at: a part of what belongs together is worth nothing.
        SocketCAN's queue holds ten frames by default, and does not let a sender wait for room.
        """
        self._note(message)
        end = time.monotonic() + _SEND
        while True:
            try:
                self.interface.send(message, timeout=_SEND)
            except Exception as error:
                full = getattr(error, "error_code", None) == errno.ENOBUFS
                if not full or time.monotonic() > end:
                    raise
            else:
                return True
            time.sleep(_FULL)
            if waiting is not None and self._is_outdated(waiting):
                return False

    def _note(self, message: can.Message) -> None:
        if self._echoes is not None and len(self._echoes) < _ECHOES:
            self._echoes[message.arbitration_id, bytes(message.data)] += 1

    def _is_echo(self, message: can.Message) -> bool:
        echoes = self._echoes
        if not echoes:
            return False
        key = message.arbitration_id, bytes(message.data)
        left = echoes.get(key, 0)
        if left > 1:
            echoes[key] = left - 1
        elif left:
            del echoes[key]
        return left > 0

    def _report(self, reason: str) -> None:
        if not self._closing:
            self._soon(self._lost, reason)

    def _soon(self, function: Callable[..., object], *args: Any) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *args)
        except RuntimeError:  # the event loop has ended, and with it every receiver
            self._closing = True
