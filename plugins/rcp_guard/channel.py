"""Lines to and from the gateway over a socket; no call blocks."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from typing import Any

__all__ = ["Channel"]

_MOST = 65536  # bytes queued for a gateway that does not read, before reports are dropped


class Channel:
    """The guard's end of the socket; `send` is thread-safe, the rest is not."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._socket = connection
        self._partial = b""
        self._waiting = b""
        self._lock = threading.Lock()
        self.ended = False
        """Whether the gateway has closed its end."""

    def fileno(self) -> int:
        """Return the descriptor to select on."""
        return self._socket.fileno()

    def receive(self) -> list[dict[str, Any]]:
        """Return the received messages; a heartbeat is an empty object."""
        parts = [self._partial]
        while not self.ended:
            try:
                part = self._socket.recv(65536)
            except BlockingIOError:
                break
            except OSError:
                part = b""
            self.ended = not part
            parts.append(part)
        *lines, self._partial = b"".join(parts).split(b"\n")
        return [message for line in lines if (message := _decode(line)) is not None]

    def send(self, message: dict[str, Any]) -> None:
        """Send a report, or drop it if the gateway does not read."""
        with self._lock:
            if len(self._waiting) < _MOST:
                self._waiting += json.dumps(message).encode() + b"\n"
            with contextlib.suppress(OSError):
                self._waiting = self._waiting[self._socket.send(self._waiting) :]


def _decode(line: bytes) -> dict[str, Any] | None:
    if not line:
        return {}
    try:
        message = json.loads(line)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None
