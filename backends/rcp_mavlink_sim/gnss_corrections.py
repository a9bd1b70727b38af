"""Corrections for the GNSS receiver, put together from their pieces as ArduPilot does it."""

from __future__ import annotations

from typing import Any

__all__ = ["GnssCorrections"]

_PIECE, _MOST = 180, 4
_FRAGMENTED = 1


class GnssCorrections:
    """What reaches the receiver: whole messages only."""

    def __init__(self) -> None:
        self.received: list[bytes] = []
        self._sequence = -1
        self._pieces: dict[int, bytes] = {}
        self._count = 0

    def take(self, message: Any) -> None:
        """Take GPS_RTCM_DATA; a message that lost a piece is given up with the next."""
        data = bytes(message.data[: message.len])
        if message.len > _PIECE:
            return
        if not message.flags & _FRAGMENTED:
            self.received.append(data)
            return
        number, sequence = message.flags >> 1 & 3, message.flags >> 3 & 31
        if sequence != self._sequence:
            self._sequence, self._pieces, self._count = sequence, {}, 0
        self._pieces[number] = data
        if len(data) < _PIECE or number == _MOST - 1:
            self._count = number + 1
        if self._count and len(self._pieces) == self._count:
            self.received.append(b"".join(self._pieces[n] for n in range(self._count)))
            self._pieces, self._count = {}, 0
