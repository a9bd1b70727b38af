"""Changes written to the store in one transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import structlog

from rcp_store.chain import Row

__all__ = ["Batch", "commit", "run_query"]

log = structlog.get_logger("rcp.store")
_SIZES = (64, 16, 4, 1)
"""Rows in one statement; few sizes, so that SQLite keeps their statements prepared."""
_TOGETHER = {size: ", ".join(["(?, ?, ?)"] * size) for size in _SIZES}


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
    with base:
        if batch.puts:
            puts = batch.puts.items()
            _insert(base, "kept", [(*place, data) for place, data in puts if data is not None])
            gone = [place for place, data in puts if data is None]
            base.executemany("DELETE FROM kept WHERE place = ? AND key = ?", gone)
        _insert(base, "audit", batch.rows)
        if batch.before:
            base.execute("DELETE FROM audit WHERE seq < ?", (batch.before,))


def _insert(base: sqlite3.Connection, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
    """Insert rows of three columns, several in one statement.

    Each statement gives up the interpreter's lock and waits for it again, which the event loop's
    thread needs meanwhile: for a row each, this took longer than to write them.
    """
    done = 0
    for size in _SIZES:
        text = f"INSERT OR REPLACE INTO {table} VALUES {_TOGETHER[size]}"  # noqa: S608 - both are constants
        while len(rows) - done >= size:
            base.execute(text, tuple(chain.from_iterable(rows[done : done + size])))
            done += size


def run_query(base: sqlite3.Connection, work: Callable[[sqlite3.Connection], Any]) -> Any:
    """Return the result of a query; None if it failed."""
    try:
        return work(base)
    except Exception:  # a failing query must not end the writer thread
        log.exception("store_look_failed")
        return None
