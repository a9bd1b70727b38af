"""Bytes to frames: checked, counted, and decoded only when needed."""

from __future__ import annotations

from typing import Any

from rcp_mavlink.dialect import Definition, Dialect
from rcp_mavlink.signing import Signing

__all__ = ["Frame", "Framer", "Stats", "rebuilt", "text_of"]

_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_SIGNATURE = 13  # bytes
_UNSIGNED = frozenset({109})
"""RADIO_STATUS comes from the radio itself, which has no signing key."""


class Frame:
    """One received message; `decode` returns its value."""

    __slots__ = ("component", "data", "definition", "payload", "system")

    def __init__(
        self, definition: Definition, system: int, component: int, payload: bytes, data: bytes
    ) -> None:
        self.definition = definition
        self.system = system
        self.component = component
        self.payload = payload
        self.data = data

    def decode(self) -> Any:
        """Return its value in the units of the tree."""
        return self.definition.decode(self.payload)

    def fields(self) -> dict[str, Any]:
        """Return its fields as on the wire."""
        return self.definition.fields_of(self.payload)


def text_of(raw: bytes) -> str:
    """Return the text in a field of bytes, up to its end."""
    return raw.split(b"\0", 1)[0].decode("utf-8", "replace")


class Stats:
    """Reception statistics of one link."""

    __slots__ = (
        "bad", "bytes", "dropped", "frames", "lost", "rejected", "sent", "unknown", "unsigned",
    )  # fmt: skip

    def __init__(self) -> None:
        self.frames = self.bytes = self.sent = 0
        self.bad = 0
        """Bytes outside any frame, and frames with a wrong checksum."""
        self.unknown = 0
        """Frames with messages that are not in the dialect."""
        self.lost = 0
        """Gaps in the senders' sequence numbers."""
        self.unsigned = 0
        """Frames that lack the required signature."""
        self.rejected = 0
        """Frames signed with another key, and replayed ones."""
        self.dropped = 0
        """Frames that were not sent, as too many waited already."""


class Framer:
    """Extracts the frames from the bytes of one link."""

    def __init__(self, dialect: Dialect, signing: Signing | None) -> None:
        from fastcrc.crc16 import mcrf4xx

        self._crc = mcrf4xx
        self._known = {n: (d, bytes((d.crc_extra,))) for n, d in dialect.by_id.items()}
        self._signing = signing
        self._left = b""
        self._next: dict[int, int] = {}
        self.stats = Stats()

    def reset(self) -> None:
        """Discard partial frames, as after a reconnection."""
        self._left = b""

    def datagram(self, data: bytes) -> list[Frame]:
        """Return the frames of a datagram; a truncated frame is lost."""
        found, at = self._frames(data)
        self.stats.bad += len(data) - at
        return found

    def stream(self, data: bytes) -> list[Frame]:
        """Return the complete frames; an incomplete one is kept until its rest arrives."""
        data = self._left + data if self._left else data
        found, at = self._frames(data)
        self._left = data[at:]
        return found

    def _frames(self, data: bytes) -> tuple[list[Frame], int]:
        """Return the frames and the offset of the first byte that may start another one."""
        found: list[Frame] = []
        stats, known, crc = self.stats, self._known, self._crc
        at, end = 0, len(data)
        stats.bytes += end
        while at < end:
            magic = data[at]
            if magic == _V2:
                if end - at < 12:
                    break
                length, flags = data[at + 1], data[at + 2]
                start = at + 10
                number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
                seq, system, component = data[at + 4], data[at + 5], data[at + 6]
            elif magic == _V1:
                if end - at < 8:
                    break
                length, flags, start, number = data[at + 1], 0, at + 6, data[at + 5]
                seq, system, component = data[at + 2], data[at + 3], data[at + 4]
            else:
                at = self._skip(data, at)
                continue
            stop = start + length
            after = stop + 2 + (_SIGNATURE if flags & _SIGNED else 0)
            entry = known.get(number)
            if entry is None or flags & ~_SIGNED:
                stats.unknown += 1
                at += 1
                continue
            if after > end:
                break
            definition, extra = entry
            if crc(data[at + 1 : stop] + extra) != data[stop] | data[stop + 1] << 8:
                stats.bad += 1
                at += 1
                continue
            whole = data[at:after]
            at = after
            if self._signing is not None and number not in _UNSIGNED:
                if not flags & _SIGNED:
                    stats.unsigned += 1
                    continue
                if not self._signing.genuine(whole):
                    stats.rejected += 1
                    continue
            self._count(seq, system << 8 | component)
            found.append(Frame(definition, system, component, data[start:stop], whole))
        stats.frames += len(found)
        return found, at

    def _skip(self, data: bytes, at: int) -> int:
        """Return the offset of the next byte that may start a frame."""
        places = [place for place in (data.find(b"\xfd", at), data.find(b"\xfe", at)) if place >= 0]
        place = min(places, default=len(data))
        self.stats.bad += place - at
        return place

    def _count(self, seq: int, sender: int) -> None:
        expected = self._next.get(sender)
        if expected is not None and seq != expected:
            missing = (seq - expected) & 0xFF
            if missing < 128:  # larger gaps: the frame is late, or the sender has restarted
                self.stats.lost += missing
        self._next[sender] = (seq + 1) & 0xFF


def rebuilt(frame: Frame, signing: Signing | None, link: int) -> bytes:
    """Return a frame as MAVLink 2 with the same sender, unsigned or signed anew."""
    from fastcrc.crc16 import mcrf4xx

    definition, payload = frame.definition, frame.payload.rstrip(b"\0") or frame.payload[:1]
    seq = frame.data[4] if frame.data[0] == _V2 else frame.data[2]
    flags = 0 if signing is None else _SIGNED
    head = bytes((len(payload), flags, 0, seq, frame.system, frame.component))
    body = head + definition.id.to_bytes(3, "little") + payload
    crc = mcrf4xx(body + bytes((definition.crc_extra,)))
    whole = bytes((_V2,)) + body + crc.to_bytes(2, "little")
    return whole if signing is None else whole + signing.signature(whole, link)
