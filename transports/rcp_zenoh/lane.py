"""One priority class of a pipe: its numbers, its window, and what is being joined from parts.

Zenoh keeps the order within one key and priority only, so that each class counts by itself.
"""

from __future__ import annotations

from collections import deque
from enum import IntEnum

import zenoh

from rcp_zenoh.delay_window import DelayWindow

__all__ = ["PART", "WHOLE", "WINDOWS", "Lane", "Priority"]

PART = 16_384  # bytes of one part of a long message
WHOLE = 61_440  # bytes of a message that is sent in one piece: Zenoh's own batches hold 64 KiB


class Priority(IntEnum):
    """The priority classes; a lower number overtakes the higher ones."""

    STOP = 0
    """E-stops and their replies; never held back."""
    CONTROL = 1
    """All other requests, replies and notices."""
    UPDATES = 2
    BULK = 3
    """Long messages of any kind, in parts."""


WINDOWS = {
    Priority.STOP: 1 << 62,
    Priority.CONTROL: 524_288,
    Priority.UPDATES: 262_144,
    Priority.BULK: 65_536,  # at first
}
"""Bytes of each class that may be on the way."""

_ZENOH = {
    Priority.STOP: zenoh.Priority.REAL_TIME,
    Priority.CONTROL: zenoh.Priority.INTERACTIVE_HIGH,
    Priority.UPDATES: zenoh.Priority.DATA,
    Priority.BULK: zenoh.Priority.BACKGROUND,
}


class Lane:
    """Both directions of one class."""

    __slots__ = (
        "_delay",
        "_joined",
        "_priority",
        "_publisher",
        "_session",
        "_size",
        "_step",
        "acknowledged",
        "key",
        "parts",
        "received",
        "seen",
        "sent",
        "taken",
        "written",
    )

    def __init__(
        self, session: zenoh.Session, key: zenoh.KeyExpr | str, priority: Priority
    ) -> None:
        self._session, self._priority = session, priority
        self.key = key
        """On which it sends; a text is not declared, and takes none of Zenoh's numbers."""
        self._publisher: zenoh.Publisher | None = None
        self._delay = DelayWindow(PART) if priority is Priority.BULK else None
        self._step = 1 if priority is Priority.BULK else WINDOWS[priority] // 4
        self.sent = self.written = 0
        """Messages and bytes sent."""
        self.taken = 0
        """Bytes that the other end has acknowledged."""
        self.seen = self.received = 0
        """Messages and bytes received."""
        self.acknowledged = 0
        """Bytes received that the other end has been told of."""
        self.parts: deque[tuple[bytes, bool]] = deque()
        """Parts that wait for room in the window, each with whether it is the last one."""
        self._joined: list[bytes] = []
        self._size = 0

    @property
    def buffered(self) -> int:
        """Bytes on the way."""
        return self.written - self.taken

    @property
    def room(self) -> int:
        """Bytes that the window still has room for."""
        return self._window - self.buffered

    @property
    def _window(self) -> int:
        return WINDOWS[self._priority] if self._delay is None else self._delay.size

    @property
    def due(self) -> bool:
        """Whether the other end should be told what was received: it may wait for room."""
        unsaid = self.received - self.acknowledged
        return unsaid >= self._step or (unsaid > 0 and not self.acknowledged)

    @property
    def joining(self) -> bool:
        """Whether parts of a message have been received."""
        return self._size > 0

    def count(self, size: int) -> None:
        """Number a message to send."""
        self.sent += 1
        self.written += size
        if self._delay is not None:
            self._delay.sent(self.written)

    def take(self, number: int) -> bool:
        """Note how many bytes the other end has; return whether these are more than before."""
        if not self.taken < number <= self.written:
            return False
        self.taken = number
        if self._delay is not None:
            self._delay.taken(number)
        return True

    def put(self, data: bytes, attachment: bytes) -> None:
        """Put a message on the wire."""
        if isinstance(self.key, str):
            self._session.put(
                self.key,
                data,
                attachment=attachment,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_ZENOH[self._priority],
            )
            return
        if self._publisher is None:  # most links never use some classes
            self._publisher = self._session.declare_publisher(
                self.key,
                congestion_control=zenoh.CongestionControl.DROP,  # never blocks the event loop
                priority=_ZENOH[self._priority],
                # Not even stops are `express`: each would take a batch of its own, and those to a
                # hundred robots more batches than a queue has, so that the rest were dropped.
            )
        self._publisher.put(data, attachment=attachment)

    def cut(self, data: bytes, size: int) -> None:
        """Queue a long message in parts of a `size`."""
        last = (len(data) - 1) // size
        self.parts.extend((data[at * size : (at + 1) * size], at == last) for at in range(last + 1))

    def join(self, data: bytes, longest: int, *, last: bool) -> tuple[bytes | None, int] | None:
        """Add a part; return the message after its last one, or None for one that is too long."""
        if last and not self._size:
            return (data if len(data) <= longest else None), len(data)
        self._size += len(data)
        if self._size <= longest:
            self._joined.append(data)
        else:
            self._joined.clear()
        if not last:
            return None
        size, parts = self._size, self._joined
        self._size, self._joined = 0, []
        return (b"".join(parts) if size <= longest else None), size

    def close(self) -> None:
        """Stop sending."""
        if self._publisher is not None:
            self._publisher.undeclare()
