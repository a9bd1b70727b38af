"""Packets of a VESC over CAN: commands with answers, longer than a frame, as VESC Tool sends them.

A packet fills the receiver's buffer, part by part, and is processed when its length and checksum fit.
The parts do not tell who sends them; only the last frame does.
"""

from __future__ import annotations

import binascii

__all__ = ["PING", "PONG", "SHORT", "Assembler", "frames"]

_FILL, _FILL_LONG, _PROCESS, SHORT = 5, 6, 7, 8
PING, PONG = 17, 18
_ANSWER, _NO_ANSWER = 0, 1
_AT_ONCE = 6  # bytes of a packet that fits into one frame
_LONGEST = 512  # bytes of a packet
_BEYOND = 255  # the last place that a short part can have


def frames(
    payload: bytes, *, to: int, sender: int, answers: bool = False
) -> list[tuple[int, bytes]]:
    """Return identifiers and data of the frames of a packet; `answers` if it is itself an answer."""
    head = bytes((sender, _NO_ANSWER if answers else _ANSWER))
    if len(payload) <= _AT_ONCE:
        return [(SHORT << 8 | to, head + payload)]
    found: list[tuple[int, bytes]] = []
    place = 0
    while place < len(payload) and place <= _BEYOND:
        found.append((_FILL << 8 | to, bytes((place,)) + payload[place : place + 7]))
        place += 7
    while place < len(payload):
        where = place.to_bytes(2, "big")
        found.append((_FILL_LONG << 8 | to, where + payload[place : place + 6]))
        place += 6
    size = len(payload).to_bytes(2, "big")
    check = binascii.crc_hqx(payload, 0).to_bytes(2, "big")
    found.append((_PROCESS << 8 | to, head + size + check))
    return found


class Assembler:
    """Joins the parts that one receiver gets."""

    def __init__(self) -> None:
        self._buffer = bytearray(_LONGEST)

    def take(self, command: int, data: bytes) -> tuple[int, bytes] | None:
        """Take a frame; return the sender and the packet, if this completes one."""
        if command == _FILL and data:
            self._fill(data[0], data[1:])
        elif command == _FILL_LONG and len(data) >= 2:
            self._fill(int.from_bytes(data[:2], "big"), data[2:])
        elif command == SHORT and len(data) > 2:
            return data[0], data[2:]
        elif command == _PROCESS and len(data) >= 6:
            payload = bytes(self._buffer[: int.from_bytes(data[2:4], "big")])
            if payload and binascii.crc_hqx(payload, 0) == int.from_bytes(data[4:6], "big"):
                return data[0], payload
        return None

    def _fill(self, place: int, part: bytes) -> None:
        if place + len(part) <= _LONGEST:
            self._buffer[place : place + len(part)] = part
