"""Changes written to the store in one transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from typing import Any

import structlog

from rcp_store.chain import Row

__all__ = ["Batch", "commit", "run_query"]

log = structlog.get_logger("rcp.store")


class Batch:
    """The changes of one transaction."""

    __slots__ = ("before", "latches", "looks", "puts", "rows", "upto")

    def __init__(self) -> None:
        self.latches: bytes | None = None
        """New content of the latch file; None if no latch has changed."""
        self.looks: list[tuple[Callable[[sqlite3.Connection], Any], Callable[[Any], None]]] = []
        self.puts: dict[tuple[str, str], bytes | None] = {}
        self.rows: list[Row] = []
        self.before = 0
        self.upto = 0

    def take(self, later: Batch) -> None:
        """Add the changes of a later batch."""
        self.puts.update(later.puts)
        self.rows += later.rows
        self.looks += later.looks
        self.latches = later.latches or self.latches
        self.before = max(self.before, later.before)
        self.upto = later.upto


def commit(base: sqlite3.Connection, batch: Batch) -> None:
    """Write a batch in one transaction."""
    kept = [(place, key, data) for (place, key), data in batch.puts.items() if data is not None]
    gone = [key for key, data in batch.puts.items() if data is None]
    with base:
        base.executemany("INSERT OR REPLACE INTO kept VALUES (?, ?, ?)", kept)
        base.executemany("DELETE FROM kept WHERE place = ? AND key = ?", gone)
        base.executemany("INSERT OR REPLACE INTO audit VALUES (?, ?, ?)", batch.rows)
        if batch.before:
            base.execute("DELETE FROM audit WHERE seq < ?", (batch.before,))


def run_query(base: sqlite3.Connection, work: Callable[[sqlite3.Connection], Any]) -> Any:
    """Return the result of a query; None if it failed."""
    try:
        return work(base)
    except Exception:  # a failing query must not end the writer thread
        log.exception("store_look_failed")
        return None
