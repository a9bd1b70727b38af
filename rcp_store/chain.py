"""The hash chain of the ledger.

Each record's SHA-256 covers the previous hash and the record's bytes exactly as stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec

from rcp_protocol.clock import iso, now

__all__ = [
    "GENESIS",
    "Head",
    "Row",
    "decoded",
    "joint",
    "link",
    "parse_head",
    "seal",
    "written",
]

_JOINTS = ("gap", "repair")
_encode = msgspec.json.Encoder().encode

GENESIS = bytes(32)
"""The hash before the first record."""
Row = tuple[int, bytes, bytes]
"""A stored record: number, hash, bytes."""
Head = tuple[int, bytes]
"""A record's number and hash; those of the last record identify the whole chain."""


def link(previous: bytes, data: bytes) -> bytes:
    """Return the hash of a record."""
    return hashlib.sha256(previous + data).digest()


def written(head: Head) -> str:
    """Format a head as `SEQ:HASH`."""
    return f"{head[0]}:{head[1].hex()}"


def parse_head(text: str) -> Head:
    """Parse a head from `SEQ:HASH`.

    :raises ValueError: it is malformed.
    """
    seq, _, digest = text.strip().partition(":")
    found = int(seq), bytes.fromhex(digest)
    if found[0] < 0 or len(found[1]) != 32:
        raise ValueError(text)
    return found


def seal(after: Head, what: str, facts: Mapping[str, Any]) -> Row:
    """Make the record that follows a head, for an event without a client."""
    seq = after[0] + 1
    if None in facts.values():
        facts = {key: value for key, value in facts.items() if value is not None}
    data = _encode({"seq": seq, "time": iso(now()), "what": what, **facts})
    return seq, hashlib.sha256(after[1] + data).digest(), data


def joint(record: dict[str, Any]) -> Head | None:
    """Return the head that a record names as its predecessor, which may be lost.

    The chain continues after damage with such a record: `gap` or `repair`.
    """
    if record.get("what") not in _JOINTS:
        return None
    try:
        return parse_head(str(record.get("head")))
    except ValueError:
        return None


def decoded(data: bytes) -> dict[str, Any]:
    """Return a stored record; empty if it is invalid."""
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return {}
