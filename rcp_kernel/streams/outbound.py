"""What waits for clients, in bytes: for each of them, and for all together.

A share of what waits for a client is its own and counts for nobody; what it holds beyond counts in
the total. So clients that leave everything unread take no other client's replies from it. Bytes
that many clients wait for are counted for each of them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import structlog

if TYPE_CHECKING:
    from rcp_kernel.config.limits import Limits

__all__ = ["SHARE", "SMALL", "Backlog", "Outbound"]

log = structlog.get_logger("rcp.streams")
SHARE = 65_536  # bytes that may wait for any client, whatever waits for the others
SMALL = 4096  # bytes: a shorter reply is worth as much as the refusal in its place
_LOOK = 0.25  # s between looks while the total is reached
_STALLED = 5.0  # s that a client may hold more than its share, once the total is reached


class Waiting(Protocol):
    """An outbox that waits for room."""

    def again(self) -> None:
        """Flush what waits."""
        ...


class Backlog:
    """The bytes that wait for one client: here, in its transport, or for its return."""

    __slots__ = ("_closed", "_outbound", "counted", "cut", "since", "size")

    def __init__(self, outbound: Outbound, cut: Callable[[], None] | None = None) -> None:
        self._outbound = outbound
        self._closed = False
        self.cut = cut
        """Lets go of the client, or of what waits for it; None where neither can be done."""
        self.size = 0
        self.counted = 0
        """What of it counts in the total."""
        self.since = 0.0
        """Since when it holds more than its share, by the loop's clock."""

    def set(self, size: int) -> None:
        """Take notice of how much waits now."""
        if self._closed:
            return
        self.size = size
        counted = size if size > SHARE else 0
        if counted != self.counted:
            self._outbound.count(self, counted)

    @property
    def overfull(self) -> bool:
        """Whether more waits than may: for this client, or for all together with a part of it."""
        return self.size > self._outbound.each or (self.counted > 0 and self.full)

    @property
    def full(self) -> bool:
        """Whether as much waits for all clients together as may."""
        return self._outbound.total >= self._outbound.limit

    @property
    def crowded(self) -> bool:
        """Whether so much waits that the client should be asked for nothing more."""
        outbound = self._outbound
        return self.size > SHARE and (
            self.size > outbound.each // 2 or outbound.total >= outbound.limit
        )

    def refuses(self, size: int) -> bool:
        """Tell whether a reply of so many bytes is too much beside what waits already.

        Where nothing else waits, it goes, however long it is.
        """
        if size <= SMALL or self.size + size <= SHARE:
            return False
        outbound = self._outbound
        over = self.size > 0 and self.size + size > outbound.each
        if over or outbound.total >= outbound.limit:
            outbound.refused += 1
            return True
        return False

    def wait(self, outbox: Waiting) -> None:
        """Have an outbox flushed when there is room in the total again."""
        self._outbound.wait(outbox)

    def close(self, outbox: Waiting | None = None) -> None:
        """Count nothing any more, and flush the outbox no more that it belongs to."""
        if outbox is not None:
            self._outbound.forget(outbox)
        self.cut = None
        self.set(0)
        self._closed = True


class Outbound:
    """What waits for all clients together."""

    def __init__(self, loop: asyncio.AbstractEventLoop, limits: Limits) -> None:
        self._loop = loop
        self._holders: set[Backlog] = set()
        self._waiting: dict[Waiting, None] = {}
        self._timer: asyncio.TimerHandle | None = None
        self.total = 0
        """Bytes, without the clients' own shares."""
        self.refused = 0
        """Replies that were not sent because too much waited."""
        self.cut = 0
        """Clients that were let go of because they took nothing."""
        self.configure(limits)

    def configure(self, limits: Limits) -> None:
        """Take over other limits; what waits already goes on waiting."""
        self.each = limits.queue_bytes
        self.limit = limits.queue_bytes_total

    def open(self, cut: Callable[[], None] | None = None) -> Backlog:
        """Count the bytes of one client more; its owner closes it."""
        return Backlog(self, cut)

    def count(self, backlog: Backlog, counted: int) -> None:
        """Count what a backlog holds beyond its share."""
        self.total += counted - backlog.counted
        if not backlog.counted:
            backlog.since = self._loop.time()
            self._holders.add(backlog)
        elif not counted:
            self._holders.discard(backlog)
        backlog.counted = counted
        if self.total >= self.limit:
            self._watch()
        elif self._waiting:
            self._wake()

    def has_room(self, size: int) -> bool:
        """Tell whether a reply of so many bytes may go to a client for whom nothing else waits."""
        if size <= SHARE or self.total < self.limit:
            return True
        self.refused += 1
        return False

    def wait(self, outbox: Waiting) -> None:
        """Have an outbox flushed when there is room again."""
        self._waiting[outbox] = None
        self._watch()

    def forget(self, outbox: Waiting) -> None:
        """Flush an outbox no more."""
        self._waiting.pop(outbox, None)

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, {}
        for outbox in waiting:
            outbox.again()

    def _watch(self) -> None:
        if self._timer is None:
            self._timer = self._loop.call_later(_LOOK, self._look)

    def _look(self) -> None:
        """Let go of the clients that have held most for long, until the others have room."""
        self._timer = None
        over = self.total - self.limit
        if over >= 0:
            before = self._loop.time() - _STALLED
            stalled = [b for b in self._holders if b.cut is not None and b.since <= before]
            for backlog in sorted(stalled, key=_by_size, reverse=True):
                self.cut += 1
                over -= backlog.counted
                log.warning("client_cut", waiting=backlog.size, total=self.total)
                cut, backlog.cut = backlog.cut, None
                assert cut is not None
                cut()
                if over < 0:
                    break
        self._wake()
        if self.total >= self.limit:
            self._watch()

    def close(self) -> None:
        """Look at nothing any more."""
        if self._timer is not None:
            self._timer.cancel()


def _by_size(backlog: Backlog) -> int:
    return backlog.counted
