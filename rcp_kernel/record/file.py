"""The file of a store: how it is made, opened, proved and locked, and what is said if it cannot be."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Generator
from contextlib import contextmanager
from errno import ENOSPC
from pathlib import Path

from rcp_kernel.errors import ConfigError
from rcp_kernel.record.chain import Head, parse_head

__all__ = [
    "FAULTS",
    "ROWS",
    "beside",
    "create",
    "head_beside",
    "lock",
    "open_read_only",
    "opened",
    "prove",
    "store_errors",
]

_SCHEMA = """
CREATE TABLE IF NOT EXISTS kept (
    place TEXT NOT NULL, key TEXT NOT NULL, value BLOB NOT NULL, PRIMARY KEY (place, key)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS audit (
    seq INTEGER PRIMARY KEY, hash BLOB NOT NULL, record BLOB NOT NULL
);
"""
ROWS = (
    "SELECT seq, coalesce(CAST(hash AS BLOB), x''), coalesce(CAST(record AS BLOB), x'') FROM audit"
)
"""Selects rows of the audit, as bytes whatever somebody made of them."""
_NO_ACCESS = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_AUTH,
)
FAULTS = (sqlite3.Error, UnicodeError)
"""What SQLite raises: also the other where a damaged schema is to be told of."""
_BUSY = 1.0  # s to wait for somebody else's lock on the database


def beside(path: Path) -> Path:
    """Return where the head of the audit is kept a second time."""
    return path.with_name(path.name + ".head")


def head_beside(path: Path) -> Head | None:
    """Return the head of the audit that the last writer left beside a database."""
    try:
        return parse_head(beside(path).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def opened(path: Path) -> sqlite3.Connection:
    """Open a store to write.

    :raises sqlite3.Error: it cannot be.
    """
    base = sqlite3.connect(path, timeout=_BUSY)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("PRAGMA synchronous=NORMAL")
    base.executescript(_SCHEMA)
    return base


def prove(base: sqlite3.Connection) -> None:
    """Find out whether what survives can be read, and whether anything can be written.

    :raises sqlite3.Error: it cannot.
    """
    [(found,)] = base.execute("PRAGMA quick_check('kept')").fetchmany(1)
    if found != "ok":
        raise sqlite3.DatabaseError(found)
    with base:
        base.execute("INSERT OR REPLACE INTO kept VALUES ('store', 'proof', x'c0')")
        base.execute("DELETE FROM kept WHERE place = 'store'")


def create(path: Path) -> None:
    """Make the database all at once: whoever looks finds it whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    for suffix in ("", "-journal", "-wal", "-shm"):  # of a start that was cut off
        fresh.with_name(fresh.name + suffix).unlink(missing_ok=True)
    _claim(fresh)
    opened(fresh).close()
    fresh.replace(path)


def _claim(path: Path) -> None:
    """Have a file whose content is nobody else's to read."""
    os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))


def lock(path: Path) -> sqlite3.Connection:
    """Keep a second gateway from the same store; the system lets go when the process ends."""
    place = path.with_name(path.name + ".lock")
    _claim(place)
    held = sqlite3.connect(place, timeout=0, isolation_level=None)
    try:
        held.execute("BEGIN EXCLUSIVE")
    except sqlite3.Error as error:
        held.close()
        if error.sqlite_errorcode != sqlite3.SQLITE_BUSY:
            raise
        raise _Taken("another gateway is using it") from None
    return held


@contextmanager
def store_errors(path: Path) -> Generator[None]:
    """Have what is wrong with a store said in full.

    :raises ConfigError: with what to do next.
    """
    try:
        yield
    except (OSError, *FAULTS) as error:
        raise ConfigError(
            f"[store] path = '{path}' cannot be opened: {error}. {_remedy(path, error)}"
        ) from None


class _Taken(sqlite3.OperationalError):
    """Another gateway has the store."""


def _remedy(path: Path, error: Exception) -> str:
    if isinstance(error, _Taken):
        return "Stop the other gateway, or give this one a path of its own."
    number = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if number in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return "Close the program that holds it open."
    if number == sqlite3.SQLITE_FULL or getattr(error, "errno", None) == ENOSPC:
        return "Free some of the disk."
    if isinstance(error, OSError) or number in _NO_ACCESS:
        return "Give the gateway's user a folder that it may write to."
    return (
        f"Bring back a copy of it, or move it and its neighbours ({path.name}.*, {path.name}-*) "
        "away, and keep them for a look: without them the gateway begins anew, with no e-stop "
        "latched and no record."
    )


def open_read_only(path: Path) -> sqlite3.Connection:
    """Open a store to look at, also while its gateway runs.

    :raises ConfigError: it is not there, or not a store.
    """
    try:
        base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=_BUSY)
        base.execute("SELECT 1 FROM audit LIMIT 1")
    except FAULTS as error:
        raise ConfigError(f"the store '{path}' cannot be read: {error}") from None
    return base
