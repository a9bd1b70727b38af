"""The tamper-evident log of a store: each record is sealed by a hash over the one before it.

Records are sealed on the event loop, in order; the store's thread writes them.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from typing import Any

from rcp_kernel.store.chain import GENESIS, Head, decoded, seal
from rcp_kernel.store.store import Store

__all__ = ["Ledger"]


class Ledger:
    """The log as a feature writes it. For the event loop's thread only."""

    def __init__(self, store: Store) -> None:
        self._store = store
        last = store.rows(1)
        self.head: Head = (last[0][0], last[0][1]) if last else (0, GENESIS)
        """The last record made; not necessarily committed yet."""
        self._found = self.head[0]
        self.settled = store.settled
        """Calls back on the event loop once all that the store was given before is committed."""

    def add(self, what: str, facts: Mapping[str, Any]) -> bytes:
        """Seal a record and have it written; return its bytes. Facts that are None are left out.

        :raises TypeError, ValueError, OverflowError, RecursionError: a fact is not plain data.
        """
        seq, digest, data = seal(self.head, what, facts)
        self.head = (seq, digest)
        self._store.append((seq, digest, data))
        return data

    def past(self, last: int) -> list[dict[str, Any]]:
        """Return the last records of earlier runs. Blocks: for the start only."""
        rows = [decoded(data) for seq, _, data in self._store.rows(last) if seq <= self._found]
        return [record for record in rows if record]

    def prune(self, upto: Head) -> None:
        """Delete the oldest records, up to this one."""
        seq, digest = upto
        # In one transaction: the chain begins after what the anchor names.
        self._store.put("audit", "anchor", {"seq": seq, "hash": digest})
        self._store.prune(seq + 1)

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Have the store's thread look something up; `then` gets it on the event loop."""
        self._store.look(work, then)

    @property
    def keeps(self) -> bool:
        """Whether records survive the process."""
        return self._store.keeps

    @property
    def idle(self) -> bool:
        """Whether all that the store was given is committed."""
        return self._store.idle

    @property
    def waiting(self) -> int:
        """How many records are not committed yet."""
        return self._store.waiting

    @property
    def trouble(self) -> str | None:
        """Why nothing can be written at present."""
        return self._store.trouble

    @property
    def damage(self) -> str | None:
        """Why the database that is configured is left alone, and another one is written."""
        return self._store.damage

    @property
    def left(self) -> Head | None:
        """The head as the earlier run left it beside the database."""
        return self._store.left

    @property
    def committed(self) -> Head | None:
        """The last record that this run committed."""
        return self._store.head
