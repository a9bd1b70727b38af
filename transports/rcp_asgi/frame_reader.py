"""picows' protocol with reads limited to what can be parsed within one or two milliseconds."""

from __future__ import annotations

import logging
from typing import Any

from picows import WSAutoPingStrategy
from picows.picows import WSProtocol  # type: ignore[attr-defined] - pinned, see pyproject.toml

__all__ = ["FrameReader"]

_silent = logging.getLogger("rcp.picows")
_silent.setLevel(logging.CRITICAL)  # otherwise each connection would log three lines
_BUFFER = 16 * 1024  # bytes at first; grows with the messages
_AT_ONCE = 16 * 1024  # bytes: about 500 pings
_whole_buffer = WSProtocol.get_buffer


class FrameReader(WSProtocol):
    """Parses frames.

    picows' own buffer doubles whenever it is full, never shrinks, and is offered as a whole: after
    a burst of short messages, one read could return tens of thousands of them in one loop
    iteration.
    """

    def __init__(self, listen: Any, longest: int) -> None:
        super().__init__(
            None,  # host, port and path, for clients only
            None,
            False,  # is_client_side
            listen,
            _silent,
            False,  # disconnect_on_exception: an exception of the receiver is a bug
            None,  # handshake timeout: it completes in the next lines
            False,  # auto ping and its times: `Socket` does this itself
            None,
            None,
            WSAutoPingStrategy.PING_WHEN_IDLE,
            False,  # auto pong
            longest,
            None,
            _BUFFER,
        )

    def get_buffer(self, size_hint: int) -> memoryview:
        """Return the buffer for the next bytes."""
        buffer = _whole_buffer(self, size_hint)
        return buffer if len(buffer) <= _AT_ONCE else buffer[:_AT_ONCE]

    def feed(self, data: bytes) -> None:
        """Parse bytes that were read before this protocol took the transport over."""
        while data:
            room = self.get_buffer(len(data))
            part = data[: len(room)]
            room[: len(part)] = part
            self.buffer_updated(len(part))
            data = data[len(part) :]
