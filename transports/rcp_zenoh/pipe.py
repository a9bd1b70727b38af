"""Whole messages over a pair of keys: numbered, so that a loss is found, and limited in flight.

Zenoh keeps the order of one key and priority, but what is on the way when a connection breaks is
lost without a word, and a full queue drops. A missing number therefore ends the link, and the
session is resumed on a new one. Zenoh does not tell when the other end is slow, so that the
receiver acknowledges bytes, and the sender stops at `WINDOW`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import zenoh

__all__ = ["WINDOW", "Pipe"]

WINDOW = 1_048_576  # bytes in flight
_ACKNOWLEDGE = WINDOW // 4  # bytes received between two acknowledgements
_HEAD = struct.Struct("<cQ")
_MESSAGE, _TAKEN, _END = b"m", b"a", b"e"


class Pipe:
    """One end of a link; for the event loop's thread."""

    __slots__ = (
        "_acknowledged",
        "_drained",
        "_ended",
        "_publisher",
        "_received",
        "_seen",
        "_sent",
        "_taken",
        "_written",
        "closed",
    )

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        drained: Callable[[], None],
        ended: Callable[[str], None],
    ) -> None:
        self._publisher = session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,  # never blocks the loop
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        self._drained, self._ended = drained, ended
        self._sent = self._written = self._taken = 0
        self._seen = self._received = self._acknowledged = 0
        self.closed = False

    @property
    def buffered(self) -> int:
        """Bytes that the other end has not acknowledged."""
        return self._written - self._taken

    @property
    def writable(self) -> bool:
        """Whether there is room in the window."""
        return not self.closed and self.buffered < WINDOW

    def send(self, data: bytes) -> None:
        """Send one message; the caller heeds `writable`."""
        if not self.closed:
            self._sent += 1
            self._written += len(data)
            self._publisher.put(data, attachment=_HEAD.pack(_MESSAGE, self._sent))

    def receive(self, sample: zenoh.Sample) -> bytes | None:
        """Return the message in a sample, if it is one; a missing number ends the link."""
        if self.closed:
            return None
        attachment = sample.attachment
        raw = b"" if attachment is None else attachment.to_bytes()
        if len(raw) != _HEAD.size:
            self.end("the other end sent something that is not a message")
            return None
        kind, number = _HEAD.unpack(raw)
        if kind == _MESSAGE:
            return self._message(sample, number)
        if kind == _TAKEN:
            waited = not self.writable
            self._taken = min(max(self._taken, number), self._written)
            if waited and self.writable:
                self._drained()
        else:
            self.end("the other end closed the link", tell=False)
        return None

    def _message(self, sample: zenoh.Sample, number: int) -> bytes | None:
        if number != self._seen + 1:
            self.end(f"messages {self._seen + 1} to {number - 1} were lost on the way")
            return None
        self._seen = number
        data = sample.payload.to_bytes()
        self._received += len(data)
        if self._received - self._acknowledged >= _ACKNOWLEDGE:
            self._acknowledged = self._received
            self._publisher.put(b"", attachment=_HEAD.pack(_TAKEN, self._received))
        return data

    def end(self, why: str, *, tell: bool = True) -> None:
        """End the link, once."""
        if self.closed:
            return
        self.closed = True
        if tell:
            self._publisher.put(b"", attachment=_HEAD.pack(_END, 0))
        self._publisher.undeclare()
        self._ended(why)
