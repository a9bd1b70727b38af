"""Unread bytes of clients: of each of them, and in total.

Each client has a share that does not count; only bytes beyond it count in the total. Therefore
clients that read nothing cannot cost other clients their replies. Bytes shared by several clients
count for each of them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Protocol

import structlog

if TYPE_CHECKING:
    from rcp_kernel.config.limits import Limits

__all__ = ["SHARE", "SMALL", "Backlog", "Outbound"]

log = structlog.get_logger("rcp.streams")
SHARE = 65_536  # bytes that each client may leave unread, regardless of the others
SMALL = 4096  # bytes: shorter replies are not longer than a refusal
_LOOK = 0.25  # s between checks while the total is reached
_STALLED = 5.0  # s that a client may exceed its share once the total is reached


class Waiting(Protocol):
    """An outbox waiting for room."""

    def again(self) -> None:
        """Flush pending data."""
        ...


class Backlog:
    """The unread bytes of one client: here, in its transport, or kept while it is disconnected."""

    __slots__ = ("_closed", "_outbound", "close_client", "counted", "since", "size")

    def __init__(self, outbound: Outbound, cut: Callable[[], None] | None = None) -> None:
        self._outbound = outbound
        self._closed = False
        self.close_client = cut
        """Closes the client or drops its data; None if neither is possible."""
        self.size = 0
        self.counted = 0
        """The part that counts in the total."""
        self.since = float("inf")
        """Loop time since which it exceeds its share."""

    def set(self, size: int) -> None:
        """Set the current number of bytes."""
        if self._closed:
            return
        self.size = size
        counted = size if size > SHARE else 0
        if counted != self.counted:
            self._outbound.count(self, counted)

    @property
    def overfull(self) -> bool:
        """Whether this client, or the total with a part of it, exceeds the limit."""
        return self.size > self._outbound.each or (self.counted > 0 and self.full)

    @property
    def full(self) -> bool:
        """Whether the total is reached."""
        return self._outbound.total >= self._outbound.limit

    @property
    def crowded(self) -> bool:
        """Whether reading from the client should pause because of its unread bytes."""
        outbound = self._outbound
        return self.size > SHARE and (
            self.size > outbound.each // 2 or outbound.total >= outbound.limit
        )

    def refuses(self, size: int) -> bool:
        """Return whether a reply of `size` bytes does not fit.

        If nothing else is unread, a reply of any length fits.
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
        """Flush an outbox as soon as there is room in the total."""
        self._outbound.wait(outbox)

    def close(self, outbox: Waiting | None = None) -> None:
        """Stop counting, and no longer flush its outbox."""
        if outbox is not None:
            self._outbound.forget(outbox)
        self.close_client = None
        self.set(0)
        self._closed = True


class Outbound:
    """The unread bytes of all clients."""

    def __init__(self, loop: asyncio.AbstractEventLoop, limits: Limits) -> None:
        self._loop = loop
        self._holders: set[Backlog] = set()
        self._waiting: dict[Waiting, None] = {}
        self._timer: asyncio.TimerHandle | None = None
        self.total = 0
        """Bytes, without the clients' own shares."""
        self.refused = 0
        """Number of replies refused because too much was unread."""
        self.closed_clients = 0
        """Number of clients closed because they did not read."""
        self.configure(limits)

    def configure(self, limits: Limits) -> None:
        """Apply new limits; queued data is kept."""
        self.each = limits.queue_bytes
        self.limit = limits.queue_bytes_total

    def open(self, cut: Callable[[], None] | None = None) -> Backlog:
        """Start to count the bytes of a client; the caller closes the backlog."""
        return Backlog(self, cut)

    def count(self, backlog: Backlog, counted: int) -> None:
        """Update the total with the part of a backlog beyond its share."""
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
        """Return whether the total has room for a reply of `size` bytes to a client without backlog."""
        if size <= SHARE or self.total < self.limit:
            return True
        self.refused += 1
        return False

    def wait(self, outbox: Waiting) -> None:
        """Flush an outbox as soon as there is room."""
        self._waiting[outbox] = None
        self._watch()

    def forget(self, outbox: Waiting) -> None:
        """No longer flush an outbox."""
        self._waiting.pop(outbox, None)

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, {}
        for outbox in waiting:
            outbox.again()

    def _watch(self) -> None:
        if self._timer is None:
            self._timer = self._loop.call_later(_LOOK, self._poll)

    def _poll(self) -> None:
        """Close the clients that have exceeded their share for too long, largest first, until there is room."""
        self._timer = None
        over = self.total - self.limit
        if over >= 0:
            before = self._loop.time() - _STALLED
            stalled = [b for b in self._holders if b.close_client is not None and b.since <= before]
            for backlog in sorted(stalled, key=attrgetter("counted"), reverse=True):
                self.closed_clients += 1
                over -= backlog.counted
                log.warning("client_cut", waiting=backlog.size, total=self.total)
                cut, backlog.close_client = backlog.close_client, None
                assert cut is not None
                cut()
                if over < 0:
                    break
        self._wake()
        if self.total >= self.limit:
            self._watch()

    def close(self) -> None:
        """Stop checking."""
        if self._timer is not None:
            self._timer.cancel()
