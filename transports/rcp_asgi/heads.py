"""Frame heads of short unfragmented messages, built once per length."""

from __future__ import annotations

__all__ = ["BINARY", "JOINED", "TEXT", "join", "merged"]

JOINED = 16 * 1024  # bytes: longer messages are sent separately, to avoid copying them
_OBJECT = 0x7B  # "{": only JSON starts with it; CBOR and MessagePack maps do not


class Heads(dict[int, bytes]):
    """The head of a frame by the length of its payload (RFC 6455 5.2)."""

    def __init__(self, opcode: int) -> None:
        super().__init__()
        self._first = 0x80 | opcode

    def __missing__(self, size: int) -> bytes:
        if size < 126:
            head = bytes((self._first, size))
        elif size < 0x10000:
            head = bytes((self._first, 126)) + size.to_bytes(2, "big")
        else:
            return bytes((self._first, 127)) + size.to_bytes(8, "big")
        self[size] = head
        return head


TEXT = Heads(0x1)
BINARY = Heads(0x2)


def join(messages: list[bytes]) -> bytes:
    """Join framed messages; those that start as a JSON object are sent as text."""
    parts: list[bytes] = []
    for data in messages:
        parts.append((TEXT if data[0] == _OBJECT else BINARY)[len(data)])
        parts.append(data)
    return b"".join(parts)


def merged(parts: list[bytes]) -> list[bytes]:
    """Join neighbouring short parts: a copy of them costs less than a write of many parts."""
    out: list[bytes] = []
    short: list[bytes] = []
    for data in parts:
        if len(data) <= JOINED:
            short.append(data)
            continue
        if short:
            out.append(b"".join(short))
            short = []
        out.append(data)
    if short:
        out.append(b"".join(short))
    return out
