"""Datagrams to a fixed address."""

from __future__ import annotations

import socket
from typing import Any

from rcp_guard.senders import MissingLibraryError

__all__ = ["open_sender"]


class UdpSender:
    """Sends each frame as one datagram."""

    unusable = ""

    def __init__(self, to: socket.socket, frames: list[bytes]) -> None:
        self._socket = to
        self._frames = frames

    def send(self) -> None:
        """Send all frames."""
        for frame in self._frames:
            self._send(frame)

    def _send(self, frame: bytes) -> None:
        try:
            self._socket.send(frame)
        except ConnectionRefusedError:  # reports an earlier datagram; this one was not sent
            self._socket.send(frame)

    def lacks(self) -> str:
        """Return nothing: UDP receivers cannot be detected."""
        return ""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def open_sender(data: dict[str, Any]) -> UdpSender:
    """Resolve the address and create the socket."""
    try:
        host, port = data["to"]
        frames = [bytes.fromhex(frame) for frame in data["frames"]]
    except (KeyError, TypeError, ValueError) as error:
        raise MissingLibraryError(f"invalid plan data for the sender 'udp': {error!r}") from error
    family, kind, number, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    to = socket.socket(family, kind, number)
    to.setblocking(False)
    to.connect(address)
    return UdpSender(to, frames)
