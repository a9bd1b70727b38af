"""MAVLink 2 signatures: sent messages are signed, unsigned ones are rejected."""

from __future__ import annotations

import hmac
import time
from hashlib import sha256
from typing import Any

__all__ = ["Signing", "key_of"]

_EPOCH = 1_420_070_400  # s: 2015-01-01, the epoch of signature timestamps
_TICKS = 100_000  # ticks per second
_LATE = 60 * _TICKS
_MOST_STREAMS = 1024


def key_of(text: str) -> bytes:
    """Return the key for a passphrase, or the one given as 64 hexadecimal digits."""
    if len(text) == 64:
        try:
            return bytes.fromhex(text)
        except ValueError:
            pass
    return sha256(text.encode()).digest()


def _now() -> int:
    return round((time.time() - _EPOCH) * _TICKS)


class Signing:
    """One key and the timestamps of signed frames, which prevent replays."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._seen: dict[bytes, int] = {}
        self._sent = 0
        """The timestamp of the last signature of somebody else's frame."""

    def apply(self, mav: Any, link: int) -> None:
        """Configure a pymavlink `MAVLink` object to sign what it sends."""
        mav.signing.secret_key = self._key
        mav.signing.sign_outgoing = True
        mav.signing.link_id = link
        mav.signing.timestamp = _now()

    def signature(self, frame: bytes, link: int) -> bytes:
        """Return what a frame that ends with its checksum is signed with: later than any before."""
        self._sent = max(self._sent + 1, _now())
        stamp = bytes((link,)) + self._sent.to_bytes(6, "little")
        return stamp + sha256(self._key + frame + stamp).digest()[:6]

    def genuine(self, frame: bytes) -> bool:
        """Return whether a frame is signed with the key, and later than the previous one."""
        if not hmac.compare_digest(sha256(self._key + frame[:-6]).digest()[:6], frame[-6:]):
            return False
        at = int.from_bytes(frame[-12:-6], "little")
        stream = frame[5:7] + frame[-13:-12]
        before = self._seen.get(stream)
        if before is None:
            if at < _now() - _LATE or len(self._seen) >= _MOST_STREAMS:
                return False
        elif at <= before:
            return False
        self._seen[stream] = at
        return True
