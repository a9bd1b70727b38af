"""Detects a damaged store: it must not be mistaken for a new one.

Nothing here changes a file: damaged files are evidence, and perhaps the only copy.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from itertools import pairwise
from pathlib import Path

from rcp_store.chain import GENESIS, Head, Row, decoded, joint, link
from rcp_store.file import FAULTS, ROWS, HeadFile, anchor_of, is_damage, open_for_inspection
from rcp_store.latch_file import LatchFile, latches_beside

__all__ = ["find_damage", "interim_of", "known_head", "last_readable", "quick_check"]

_BOUND = 2.0  # s for checking the pages of the database at the start
_ROWS = 1000  # records verified at the start, from the end of the chain
_STEPS = 10_000  # SQLite virtual machine instructions between time checks
_TABLES = {"kept", "audit"}


def interim_of(path: Path) -> Path:
    """Return the path of the interim database used while the store is damaged."""
    return path.with_name(path.name + ".interim")


def find_damage(path: Path, *, bound: float | None = _BOUND) -> str | None:
    """Return a description of the damage, or None. Blocks for `bound` seconds at most.

    :raises sqlite3.Error: the store cannot be read for a reason other than damage.
    """
    try:
        damage = _missing(path) if _empty(path) else _look(path, bound)
    except FAULTS as error:
        if not is_damage(error):
            raise
        damage = f"the database cannot be read ({error})"
    if damage is None and interim_of(path).exists():
        damage = (
            f"the database was replaced by hand after it had been damaged, and "
            f"{interim_of(path).name} holds what was recorded meanwhile"
        )
    return damage


def _empty(path: Path) -> bool:
    return not path.exists() or path.stat().st_size == 0


def _missing(path: Path) -> str | None:
    """Return the damage if there was a database once, as other files beside it show."""
    left = _witnesses(path)
    if not left:
        return None
    what = "has been emptied" if path.exists() else "is missing"
    return f"the database {what}, although {' and '.join(left)} beside it tell that there was one"


def _witnesses(path: Path) -> list[str]:
    head = HeadFile(path)
    # An empty one is of a first start that was killed before the database was there.
    used = head.path.exists() and head.path.stat().st_size > 0 and head.read() != (0, GENESIS)
    files = [head.path] if used else []
    files += [file for file in (latches_beside(path), interim_of(path)) if file.exists()]
    return [file.name for file in files]


def _look(path: Path, bound: float | None) -> str | None:
    with closing(open_for_inspection(path)) as base:
        names = base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        if not {name for (name,) in names} >= _TABLES:
            return "its tables are missing" if _witnesses(path) else None
        size = base.execute("PRAGMA page_size").fetchone()[0]
        if path.stat().st_size % size:
            return "the file was cut off in the middle of a page"
        return quick_check(base, bound) or _chain(base, path)


def quick_check(base: sqlite3.Connection, bound: float | None) -> str | None:
    """Return SQLite's report of damage; None also if the check did not finish within `bound`.

    :raises sqlite3.Error: it cannot be read.
    """
    end = time.monotonic() + (bound or 0.0)
    if bound is not None:
        base.set_progress_handler(lambda: time.monotonic() > end, _STEPS)
    try:
        for check in ("PRAGMA quick_check('kept')", "PRAGMA quick_check"):
            [(result,)] = base.execute(check).fetchmany(1)
            if result != "ok":
                return f"SQLite finds: {' '.join(str(result).split())}"
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode != sqlite3.SQLITE_INTERRUPT:
            raise
    finally:
        base.set_progress_handler(None, 0)
    return None


def _chain(base: sqlite3.Connection, path: Path) -> str | None:
    """Verify the end of the chain, also against the head beside it."""
    file = HeadFile(path)
    head = file.read()  # before the rows: a running gateway may add more
    rows = base.execute(f"{ROWS} ORDER BY seq DESC LIMIT ?", (_ROWS,)).fetchall()
    if head is None:
        return (
            f"{file.path.name}, which tells where the record ends, is not there" if rows else None
        )
    last = rows[0][0] if rows else (anchor_of(base) or (0, GENESIS))[0]
    if head[0] > last:
        if not file.of_this_boot and _latches_known(path):
            return None  # a power failure: latches are synced individually
        return (
            f"records {last + 1} to {head[0]} are missing ({head[0] - last}): the database ends "
            f"before {file.path.name} does, as an older copy or a lost WAL would"
        )
    known = base.execute(f"{ROWS} WHERE seq = ?", (head[0],)).fetchone()
    if known is not None and known[1] != head[1]:
        return f"record {head[0]} is not the one that {file.path.name} knows"
    return _linked(rows)


def _latches_known(path: Path) -> bool:
    try:
        return LatchFile(path).read() is not None
    except (OSError, ValueError):
        return False


def _linked(rows: Sequence[Row]) -> str | None:
    """Verify records backwards from the last, up to the last repair."""
    for (seq, digest, data), (before, previous, _) in pairwise(rows):
        if joint(decoded(data)) is not None:
            return None
        if before != seq - 1:
            return f"records {before + 1} to {seq - 1} are missing"
        if link(previous, data) != digest:
            return f"record {seq} was changed"
    return None


def last_readable(path: Path) -> Head | None:
    """Return the last readable record of a database, or None."""
    try:
        with closing(open_for_inspection(path, tolerant=True)) as base:
            row = base.execute(f"{ROWS} ORDER BY seq DESC LIMIT 1").fetchone()
    except FAULTS:
        return None
    if row is None or not isinstance(row[0], int) or len(row[1]) != len(GENESIS):
        return None
    return row[0], row[1]


def known_head(path: Path) -> Head:
    """Return the last record known to have been in a store."""
    return max(HeadFile(path).read() or (0, GENESIS), last_readable(path) or (0, GENESIS))
