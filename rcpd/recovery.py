"""Recovery of readable data from a damaged database."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from rcp_store.chain import GENESIS, Row
from rcp_store.file import FAULTS, ROWS, Kept

__all__ = ["readable_kept", "readable_records", "readable_tokens"]

_BLOCK = 256  # records queried at once; in an unreadable block, one by one
_TOKENS = "id, name, hash, grants, created, expires, revoked, changed"


def readable_records(base: sqlite3.Connection, last: int) -> Iterator[Row]:
    """Yield the audit records up to a number, skipping unreadable ones."""
    for low in range(_first(base), max(last, _last(base)) + 1, _BLOCK):
        for row in _between(base, low, low + _BLOCK - 1):
            if len(row[1]) == len(GENESIS):
                yield row


def _first(base: sqlite3.Connection) -> int:
    with suppress(*FAULTS):
        return base.execute("SELECT min(seq) FROM audit").fetchone()[0] or 1
    return 1


def _last(base: sqlite3.Connection) -> int:
    with suppress(*FAULTS):
        return base.execute("SELECT max(seq) FROM audit").fetchone()[0] or 0
    return 0


def _between(base: sqlite3.Connection, low: int, high: int) -> list[Row]:
    try:
        return base.execute(f"{ROWS} WHERE seq BETWEEN ? AND ?", (low, high)).fetchall()
    except FAULTS:
        if low == high:
            return []
    return [row for seq in range(low, high + 1) for row in _between(base, seq, seq)]


def readable_kept(base: sqlite3.Connection) -> Iterator[Kept]:
    """Yield the stored key-value rows, read from the front and from the back up to any damage."""
    for order in ("", " DESC"):
        by = f"place{order}, key{order}"
        for row in _until_damage(base, f"SELECT place, key, value FROM kept ORDER BY {by}"):  # noqa: S608 - constants
            if [type(part) for part in row] == [str, str, bytes]:
                yield row


def readable_tokens(base: sqlite3.Connection) -> Iterator[tuple[Any, ...]]:
    """Yield the API keys in the same way."""
    for order in ("", " DESC"):
        yield from _until_damage(base, f"SELECT {_TOKENS} FROM tokens ORDER BY rowid{order}")  # noqa: S608 - constants


def _until_damage(base: sqlite3.Connection, query: str) -> Iterator[Any]:
    with suppress(*FAULTS):
        yield from base.execute(query)
