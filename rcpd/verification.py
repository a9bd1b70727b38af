"""Detection of tampering in a chain of audit records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from rcp_store.chain import GENESIS, Head, Row, decoded, joint, link, parse_head

__all__ = ["Verdict", "verify"]


class Verdict(msgspec.Struct):
    """The result of verifying a whole chain."""

    count: int = 0
    first: int = 0
    head: Head = (0, GENESIS)
    findings: list[tuple[int, str]] = []
    """Positions where the chain is broken, with descriptions; empty if it is intact."""


def verify(rows: Iterable[Row], anchor: Head | None, heads: Sequence[Head] = ()) -> Verdict:
    """Check every record against its predecessor, and the chain against heads stored elsewhere.

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
        """Whether `_hash` is known to be the hash of the previous record."""
        self._verdict = Verdict(first=self._last + 1)
        self._known: dict[int, bytes] = {self._last: self._hash}
        """Hashes to compare with the heads."""
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
        # A row with a changed hash is reported by its successor, which names the position.
        self._last, self._hash = seq, digest
        if seq in self._wanted:
            self._known[seq] = digest

    def _join(self, seq: int, data: bytes) -> None:
        """Continue after records lost with a damaged store, if the chain states that loss."""
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
            number, what = record["seq"], record["what"]
            facts: dict[str, Any] = record
        except (msgspec.DecodeError, UnicodeDecodeError, TypeError, KeyError):
            self._find(seq, "changed: it is not a valid record")
            return
        if number != seq:
            self._find(seq, f"moved: it says that it is record {number}")
        if what == "prune" and self._anchor is not None:
            recorded = (facts.get("to"), facts.get("hash"))
            self._anchored = self._anchored or recorded == (self._anchor[0], self._anchor[1].hex())
        self._anchored = self._anchored or joint(facts) == self._anchor
        if what == "start":
            self._restart(seq, facts.get("head"))

    def _restart(self, seq: int, head: Any) -> None:
        """Compare the chain at a gateway's start with the head left by the previous run."""
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
