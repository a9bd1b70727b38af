"""picows' protocol, which reads no more at once than can be parsed within a millisecond or two."""

from __future__ import annotations

import logging
from typing import Any

from picows import WSAutoPingStrategy
from picows.picows import WSProtocol  # type: ignore[attr-defined] - pinned, see pyproject.toml

__all__ = ["FrameReader"]

_silent = logging.getLogger("rcp.picows")
_silent.setLevel(logging.CRITICAL)  # each connection would log three lines
_BUFFER = 16 * 1024  # bytes to begin with; it grows with the messages
_AT_ONCE = 16 * 1024  # bytes: about 500 pings


class FrameReader(WSProtocol):
    """Parses frames.

    picows' own buffer doubles whenever it was filled, never shrinks, and is offered whole: after a
    storm of short messages one read would bring tens of thousands of them, in one turn of the loop.
    """

    def __init__(self, listen: Any, longest: int) -> None:
        super().__init__(
            None,  # host and port, path: for clients
            None,
            False,  # is_client_side
            listen,
            _silent,
            False,  # disconnect_on_exception: the receiver never raises, and if so, it is a bug
            None,  # handshake timeout: it is complete in the next lines
            False,  # auto ping and its times: `Socket` does it itself
            None,
            None,
            WSAutoPingStrategy.PING_WHEN_IDLE,
            False,  # auto pong
            longest,
            None,
            _BUFFER,
        )

    def get_buffer(self, size_hint: int) -> memoryview:
        """Return where the next bytes go."""
        return WSProtocol.get_buffer(self, size_hint)[:_AT_ONCE]

    def feed(self, data: bytes) -> None:
        """Parse bytes that were read before this protocol had the transport."""
        while data:
            room = self.get_buffer(len(data))
            part = data[: len(room)]
            room[: len(part)] = part
            self.buffer_updated(len(part))
            data = data[len(part) :]
