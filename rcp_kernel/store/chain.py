"""The hash chain of the ledger: how a record is sealed.

Each record's SHA-256 is over the hash before it and the record's bytes exactly as they are stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec

from rcp_kernel.clock import iso, now

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

GENESIS = bytes(32)
"""What the first record is chained to."""
Row = tuple[int, bytes, bytes]
"""A record as it is stored: its number, its hash, its bytes."""
Head = tuple[int, bytes]
"""A record's number and hash; that of the last record stands for the whole chain."""


def link(previous: bytes, data: bytes) -> bytes:
    """Return the hash of a record."""
    return hashlib.sha256(previous + data).digest()


def written(head: Head) -> str:
    """Write a head as `SEQ:HASH`."""
    return f"{head[0]}:{head[1].hex()}"


def parse_head(text: str) -> Head:
    """Read a head from `SEQ:HASH`.

    :raises ValueError: it is none.
    """
    seq, _, digest = text.strip().partition(":")
    found = int(seq), bytes.fromhex(digest)
    if found[0] < 0 or len(found[1]) != 32:
        raise ValueError(text)
    return found


def seal(after: Head, what: str, facts: Mapping[str, Any]) -> Row:
    """Make the record that follows a head, of a happening that no client has a part in."""
    seq = after[0] + 1
    told = {key: value for key, value in facts.items() if value is not None}
    data = msgspec.json.encode({"seq": seq, "time": iso(now()), "what": what, **told})
    return seq, link(after[1], data), data


def joint(record: dict[str, Any]) -> Head | None:
    """Return the head that a record names as the one before it, which may be lost itself.

    Such a record is where the chain goes on after damage: `gap` and `repair`.
    """
    if record.get("what") not in _JOINTS:
        return None
    try:
        return parse_head(str(record.get("head")))
    except ValueError:
        return None


def decoded(data: bytes) -> dict[str, Any]:
    """Return a record as it is stored; an empty one if somebody made something else of it."""
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return {}
