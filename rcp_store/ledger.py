"""The tamper-evident log of a store: each record's hash includes the previous one.

Records are sealed on the event loop, in order; the store's thread writes them.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rcp_store.chain import GENESIS, Head, decoded, seal
from rcp_store.store import Store

__all__ = ["Ledger"]


class Ledger:
    """The log as features use it, on the event loop's thread only."""

    def __init__(self, store: Store) -> None:
        self.store = store
        last = store.rows(1)
        self.head: Head = (last[0][0], last[0][1]) if last else (0, GENESIS)
        """The last record added; not necessarily committed yet."""
        self._found = self.head[0]
        self.settled = store.settled
        """Calls back on the event loop once everything added so far is committed."""

    def add(self, what: str, facts: Mapping[str, Any]) -> bytes:
        """Seal a record and queue it for writing; return its bytes. Facts that are None are omitted.

        :raises TypeError, ValueError, OverflowError, RecursionError: a fact is not plain data.
        """
        seq, digest, data = seal(self.head, what, facts)
        self.head = (seq, digest)
        if self.store.keeps:
            self.store.append((seq, digest, data))
        return data

    def past(self, last: int) -> list[dict[str, Any]]:
        """Return the last records of earlier runs. Blocks: use it only at the start."""
        rows = [decoded(data) for seq, _, data in self.store.rows(last) if seq <= self._found]
        return [record for record in rows if record]

    def prune(self, upto: Head) -> None:
        """Delete all records up to this one."""
        seq, digest = upto
        # In one transaction: the chain begins after the record named in the anchor.
        self.store.put("audit", "anchor", {"seq": seq, "hash": digest})
        self.store.prune(seq + 1)

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Run a query on the store's thread; `then` gets the result on the event loop."""
        self.store.look(work, then)

    @property
    def path(self) -> Path | None:
        """The database in use, which may have other tables; None if nothing is kept."""
        return self.store.path

    @property
    def keeps(self) -> bool:
        """Whether records survive a restart."""
        return self.store.keeps

    @property
    def idle(self) -> bool:
        """Whether everything is committed."""
        return self.store.idle

    @property
    def waiting(self) -> int:
        """Number of records not committed yet."""
        return self.store.waiting

    def behind(self, limit: int) -> bool:
        """Return whether writing fails, or more records than `limit` are not committed yet."""
        return self.store.trouble is not None or self.store.waiting > limit

    @property
    def trouble(self) -> str | None:
        """Why writing fails; None if it works."""
        return self.store.trouble

    @property
    def damage(self) -> str | None:
        """Why the interim database is used instead of the configured one; None if it is not."""
        return self.store.damage

    @property
    def left(self) -> Head | None:
        """The head that the previous run stored beside the database."""
        return self.store.left

    @property
    def committed(self) -> Head | None:
        """The last record committed in this run."""
        return self.store.head
