"""Changes written to the store in one transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from functools import cache
from itertools import chain
from typing import Any

import structlog

from rcp_store.chain import Row

__all__ = ["Batch", "commit", "run_query"]

log = structlog.get_logger("rcp.store")
_TOGETHER = 64
"""Rows in one statement at most: of two tables, as many statements as a connection keeps prepared."""
Statement = tuple[str, Sequence[Any]]
"""Its text, and what its parameters are."""


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
    """Write a batch in one transaction; `base` begins none by itself.

    Each call of SQLite gives up the interpreter's lock and waits for it again, which the event
    loop's thread needs meanwhile: for each of them this takes longer than to write a row. So rows
    share a statement, and one statement is a transaction by itself.
    """
    statements = _statements(batch)
    if len(statements) > 1:
        base.execute("BEGIN")
    with base:
        for statement in statements:
            base.execute(*statement)


def _statements(batch: Batch) -> list[Statement]:
    found = _insert("audit", batch.rows)
    if batch.puts:
        puts = batch.puts.items()
        found += _insert("kept", [(*place, data) for place, data in puts if data is not None])
        gone = "DELETE FROM kept WHERE place = ? AND key = ?"
        found += [(gone, place) for place, data in puts if data is None]
    if batch.before:
        found.append(("DELETE FROM audit WHERE seq < ?", (batch.before,)))
    return found


def _insert(table: str, rows: Sequence[tuple[Any, ...]]) -> list[Statement]:
    """Insert rows of three columns."""
    pieces = (rows[start : start + _TOGETHER] for start in range(0, len(rows), _TOGETHER))
    return [(_text(table, len(piece)), tuple(chain.from_iterable(piece))) for piece in pieces]


@cache
def _text(table: str, count: int) -> str:
    together = ", ".join(["(?, ?, ?)"] * count)
    return f"INSERT OR REPLACE INTO {table} VALUES {together}"  # noqa: S608 - both are constants


def run_query(base: sqlite3.Connection, work: Callable[[sqlite3.Connection], Any]) -> Any:
    """Return the result of a query; None if it failed."""
    try:
        return work(base)
    except Exception:  # a failing query must not end the writer thread
        log.exception("store_look_failed")
        return None
