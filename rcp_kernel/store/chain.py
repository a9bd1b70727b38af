"""The hash chain of the audit: how a record is sealed, and how tampering is found.

Each record's SHA-256 is over the hash before it and the record's bytes exactly as they are stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from rcp_kernel.clock import iso, now

__all__ = [
    "GENESIS",
    "Head",
    "Row",
    "Verdict",
    "decoded",
    "joint",
    "link",
    "parse_head",
    "seal",
    "verify",
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


def seal(after: Head, what: str, /, **facts: Any) -> Row:
    """Make the record that follows a head, of a happening that no client has a part in."""
    seq = after[0] + 1
    record = {"seq": seq, "time": iso(now()), "what": what, **facts}
    data = msgspec.json.encode({key: value for key, value in record.items() if value is not None})
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


class Verdict(msgspec.Struct):
    """What a look at the whole chain found."""

    count: int = 0
    first: int = 0
    head: Head = (0, GENESIS)
    findings: list[tuple[int, str]] = []
    """Where the chain does not hold, and how: empty if nothing was tampered with."""


def verify(rows: Iterable[Row], anchor: Head | None, heads: Sequence[Head] = ()) -> Verdict:
    """Check every record against the one before it, and the chain against heads kept elsewhere.

    `anchor` is the last record that retention deleted.
    """
    walk = _Walk(anchor, heads)
    for row in rows:
        walk.step(row)
    return walk.end()


class _Walk:
    def __init__(self, anchor: Head | None, heads: Sequence[Head]) -> None:
        self._anchor = anchor
        self._anchored = anchor is None
        self._heads = list(heads)
        self._last, self._hash = anchor or (0, GENESIS)
        self._sound = True
        """Whether `_hash` is known to be the hash of the record before."""
        self._verdict = Verdict(first=self._last + 1)
        self._known: dict[int, bytes] = {self._last: self._hash}
        """Hashes that some head is to be compared with."""
        self._wanted = {seq for seq, _ in heads}

    def _find(self, seq: int, what: str) -> None:
        self._verdict.findings.append((seq, what))

    def step(self, row: Row) -> None:
        seq, digest, data = row
        self._verdict.count += 1
        self._join(seq, data)
        if seq != self._last + 1:
            self._find(self._last + 1, f"missing: the next record is {seq}")
        elif self._sound and link(self._hash, data) != digest:
            self._find(seq, "changed: its hash does not follow from it and the record before it")
        self._look(seq, digest, data)
        # A row whose hash was changed is found again by its successor, which names the place.
        self._last, self._hash = seq, digest
        if seq in self._wanted:
            self._known[seq] = digest

    def _join(self, seq: int, data: bytes) -> None:
        """Go on after records that a damaged store has lost, where the chain says that it does."""
        head = joint(decoded(data)) if b'"head"' in data else None
        if head is None or head[0] != seq - 1 or head[0] < self._last:
            return
        if head[0] > self._last:
            lost = f"records {self._last + 1}…{head[0]} ({head[0] - self._last})"
            self._find(self._last + 1, f"missing: {lost} were lost with a damaged store")
            self._last, self._hash = head

    def _look(self, seq: int, digest: bytes, data: bytes) -> None:
        try:
            record: Any = msgspec.json.decode(data)
            said, what = record["seq"], record["what"]
            facts: dict[str, Any] = record
        except (msgspec.DecodeError, UnicodeDecodeError, TypeError, KeyError):
            self._find(seq, "changed: it is not a record")
            return
        if said != seq:
            self._find(seq, f"moved: it says that it is record {said}")
        if what == "prune" and self._anchor is not None:
            told = (facts.get("to"), facts.get("hash"))
            self._anchored = self._anchored or told == (self._anchor[0], self._anchor[1].hex())
        self._anchored = self._anchored or joint(facts) == self._anchor
        if what == "start":
            self._restart(seq, facts.get("head"))

    def _restart(self, seq: int, head: Any) -> None:
        """Compare what was there when a gateway began with the head that the one before it left."""
        try:
            left = parse_head(str(head)) if head is not None else None
        except ValueError:
            return
        if left is not None and left[0] >= seq:
            self._find(
                seq, f"missing: records {seq}…{left[0]} had been there before this gateway began"
            )
        elif left is not None and left[0] == self._last and left[1] != self._hash:
            self._find(self._last, "changed: another record had been there at the last stop")

    def end(self) -> Verdict:
        verdict = self._verdict
        if not self._anchored:
            self._find(verdict.first, "missing: no record tells of the deletion of those before it")
        for seq, digest in self._heads:
            if seq > self._last:
                self._find(self._last + 1, f"missing: the head is record {seq}")
            elif seq in self._known and self._known[seq] != digest:
                self._find(seq, "changed: the head kept elsewhere has another hash")
        verdict.head = (self._last, self._hash)
        return verdict


def decoded(data: bytes) -> dict[str, Any]:
    """Return a record as it is stored; an empty one if somebody made something else of it."""
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return {}
