"""One request and its response: uvicorn's cycle, with response heads built from checked lines.

Nearly all responses use the same header fields, so each is checked and encoded once.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from uvicorn._types import ASGISendEvent
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, RequestResponseCycle

__all__ = ["Exchange"]

_NOT_IN_NAMES = re.compile(rb'[\x00-\x1f\x7f()<>@,;:\[\]={} \t\\"]')
_NOT_IN_VALUES = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]")
_CLOSE = re.compile(rb"(?i)(?:^|,)\s*close\s*(?:,|$)")
_JOINED = 64 * 1024  # bytes of a body that is copied behind its head
_WRITTEN = {"type": "http.response.body", "body": b""}
_FRAMING = frozenset((b"content-length", b"transfer-encoding", b"connection"))


class Exchange(RequestResponseCycle):
    """Writes what an ASGI application sends."""

    _unsent = b""
    """The head of a response of known length, until its body comes."""

    async def send(self, message: ASGISendEvent) -> None:
        """Send the head or a part of the body."""
        if self.response_started or message["type"] != "http.response.start":
            await super().send(self._send_head(message) if self._unsent else message)
            return
        if self.flow.write_paused and not self.disconnected:
            await self.flow.drain()
        if not self.disconnected:
            self._start(message["status"], message.get("headers", ()))

    def _start(self, status: int, headers: Iterable[tuple[bytes, bytes]]) -> None:
        self.response_started = True
        self.waiting_for_100_continue = False
        lines = [STATUS_LINE[status]]
        closes = False
        for header in (*self.default_headers, *headers):
            name, line = _field(*header)
            if name in _FRAMING:
                closes |= self._adopt(name, header[1])
            lines.append(line)
        if not self.keep_alive and not closes:
            lines.append(b"connection: close\r\n")
        if (
            self.chunked_encoding is None
            and self.scope["method"] != "HEAD"
            and status not in (204, 304)
        ):
            self.chunked_encoding = True
            lines.append(b"transfer-encoding: chunked\r\n")
        lines.append(b"\r\n")
        if self.chunked_encoding is False:
            self._unsent = b"".join(lines)
        else:  # the body may come by another way, see `Endless`
            self.transport.write(b"".join(lines))

    def _send_head(self, message: Any) -> Any:
        """Write the head, together with a short body; return the message that is left to send."""
        head, self._unsent = self._unsent, b""
        if self.disconnected:
            return message
        body = message.get("body", b"")
        whole = len(body) == self.expected_content_length and not message.get("more_body", False)
        if whole and len(body) <= _JOINED and self.scope["method"] != "HEAD":
            self.expected_content_length = 0
            self.transport.write(head + body)
            return _WRITTEN
        self.transport.write(head)
        return message

    def _adopt(self, name: bytes, value: bytes) -> bool:
        """Set up the body as the head requires; return whether the connection closes afterwards."""
        if name == b"content-length" and self.chunked_encoding is None:
            self.expected_content_length = int(value)
            self.chunked_encoding = False
        elif name == b"transfer-encoding" and value.lower() == b"chunked":
            self.expected_content_length = 0
            self.chunked_encoding = True
        closes = name == b"connection" and _CLOSE.search(value) is not None
        if closes:
            self.keep_alive = False
        return closes


@lru_cache(maxsize=256)
def _field(name: bytes, value: bytes) -> tuple[bytes, bytes]:
    """Return a field's name in lower case, and its line.

    :raises ValueError: the name or value contains characters that are not allowed.
    """
    if _NOT_IN_NAMES.search(name) or _NOT_IN_VALUES.search(value):
        raise ValueError(f"the response header {name!r} has characters that no header may have")
    name = name.lower()
    return name, b"%b: %b\r\n" % (name, value)
