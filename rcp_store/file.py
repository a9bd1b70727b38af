"""The file of a store: creating, opening, checking and locking it, and the errors of each."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Generator, Iterable
from contextlib import closing, contextmanager
from errno import ENOSPC
from pathlib import Path
from typing import Any

import msgspec

from rcp_protocol.errors import ConfigError
from rcp_store.chain import GENESIS, Head, Row, parse_head

__all__ = [
    "FAULTS",
    "ROWS",
    "HeadFile",
    "anchor_of",
    "beside",
    "check_usable",
    "create",
    "head_beside",
    "is_damage",
    "lock",
    "open_for_inspection",
    "open_read_only",
    "open_writable",
    "store_errors",
]

Kept = tuple[str, str, bytes]
"""A row of the keyed values: table, key, value."""
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
"""Selects audit rows, always as bytes, even if somebody changed the types of the columns."""
_NO_ACCESS = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_AUTH,
)
_BAD_READ = (
    sqlite3.SQLITE_IOERR_READ,
    sqlite3.SQLITE_IOERR_SHORT_READ,
    getattr(sqlite3, "SQLITE_IOERR_DATA", 8202),
    sqlite3.SQLITE_IOERR_CORRUPTFS,
)
"""The disk does not return what was written."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")
FAULTS = (sqlite3.Error, UnicodeError)
"""Errors of SQLite; it raises `UnicodeError` for a damaged schema."""
_BUSY = 1.0  # s to wait while another process locks the database


def beside(path: Path) -> Path:
    """Return the path of the second copy of the audit's head."""
    return path.with_name(path.name + ".head")


def head_beside(path: Path) -> Head | None:
    """Return the head of the audit that the last writer stored beside a database."""
    return HeadFile(path).read()


class HeadFile:
    """The head of the audit in a file beside the database, with the machine's boot id."""

    def __init__(self, path: Path) -> None:
        self.path = beside(path)
        self._file: int | None = None
        self._last: Head = (0, GENESIS)
        self._boot = _boot()

    def read(self) -> Head | None:
        """Return the head; None if it is missing or unreadable."""
        try:
            return parse_head(self.path.read_text(encoding="ascii").split()[0])
        except (OSError, ValueError, IndexError):
            return None

    @property
    def of_this_boot(self) -> bool:
        """Whether the head was written since the machine was started; True if unknown.

        If not, a power failure may have lost the last commits.
        """
        try:
            words = self.path.read_text(encoding="ascii").split()
        except (OSError, ValueError):
            return True
        return not self._boot or len(words) < 2 or words[1] == self._boot

    def open(self, head: Head = (0, GENESIS)) -> None:
        """Open the file for writing; a new one gets `head`.

        :raises OSError: it cannot be opened.
        """
        self._last = self.read() or head
        self._file = os.open(self.path, os.O_CREAT | os.O_WRONLY, 0o600)
        if os.fstat(self._file).st_size == 0:
            self.write(head)
            os.fsync(self._file)  # an empty file would count as damage after a power failure

    def write(self, head: Head) -> None:
        """Replace the head in the open file.

        :raises OSError: it cannot be written.
        """
        assert self._file is not None
        seq, digest = head
        os.pwrite(self._file, f"{seq:020d}:{digest.hex()} {self._boot}\n".encode(), 0)
        self._last = head

    def restore(self) -> None:
        """Create the file again if it was deleted.

        :raises OSError: it cannot be created.
        """
        if self._file is not None and os.fstat(self._file).st_nlink == 0:
            self.close()
            self.open(self._last)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _boot() -> str:
    try:
        return _BOOT.read_text(encoding="ascii").strip()
    except (OSError, ValueError):  # only Linux has one
        return ""


def open_writable(path: Path) -> sqlite3.Connection:
    """Open a store for writing.

    :raises sqlite3.Error: it cannot be opened.
    """
    base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, timeout=_BUSY)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("PRAGMA synchronous=NORMAL")
    base.executescript(_SCHEMA)
    return base


def open_for_inspection(path: Path, *, tolerant: bool = False) -> sqlite3.Connection:
    """Open a database without changing it; with `tolerant`, even if its length shows truncation.

    :raises sqlite3.Error: it cannot be opened.
    """
    base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=_BUSY)
    if tolerant:
        base.execute("PRAGMA writable_schema = ON")
    return base


def is_damage(error: Exception) -> bool:
    """Return whether an error is caused by the file's content, not by access to it."""
    if isinstance(error, UnicodeError):
        return True
    if not isinstance(error, sqlite3.Error) or isinstance(error, _Taken):
        return False
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
    passing = (*_NO_ACCESS, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_FULL)
    return code in _BAD_READ or code & 0xFF not in passing


def check_usable(base: sqlite3.Connection) -> None:
    """Check that keyed values can be read, and that the database can be written.

    :raises sqlite3.Error: either fails.
    """
    [(result,)] = base.execute("PRAGMA quick_check('kept')").fetchmany(1)
    if result != "ok":
        raise sqlite3.DatabaseError(result)
    with base:
        base.execute("INSERT OR REPLACE INTO kept VALUES ('store', 'proof', x'c0')")
        base.execute("DELETE FROM kept WHERE place = 'store'")


def create(path: Path, rows: Iterable[Row] = (), kept: Iterable[Kept] = ()) -> None:
    """Create the database atomically: other processes see it complete or not at all."""
    fresh = path.with_name(path.name + ".new")
    for suffix in ("", "-journal", "-wal", "-shm"):  # left by an interrupted start
        fresh.with_name(fresh.name + suffix).unlink(missing_ok=True)
    _claim(fresh)
    with closing(open_writable(fresh)) as base, base:
        base.executemany("INSERT INTO audit VALUES (?, ?, ?)", rows)
        base.executemany("INSERT INTO kept VALUES (?, ?, ?)", kept)
    fresh.replace(path)


def _claim(path: Path) -> None:
    """Create a file that only its owner can read."""
    os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))


def lock(path: Path) -> sqlite3.Connection:
    """Lock the store against a second gateway; the system releases it when the process ends."""
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
    """Turn errors of a store into configuration errors with a remedy.

    :raises ConfigError: the store cannot be opened.
    """
    try:
        yield
    except (OSError, *FAULTS) as error:
        raise ConfigError(
            f"[store] path = '{path}' cannot be opened: {error}. {_remedy(error)}"
        ) from None


class _Taken(sqlite3.OperationalError):
    """Another gateway has the store."""


def _remedy(error: Exception) -> str:
    if isinstance(error, _Taken):
        return "Stop the other gateway, or use another path."
    number = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if number in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return "Close the program that has it open."
    if number == sqlite3.SQLITE_FULL or getattr(error, "errno", None) == ENOSPC:
        return "Free some disk space."
    if isinstance(error, OSError) or number in _NO_ACCESS:
        return "Use a folder that the gateway's user can write to."
    return "Stop the gateway, then run `rcpd store repair`, or `rcpd store restore` with a backup."


def open_read_only(path: Path) -> sqlite3.Connection:
    """Open a store for reading, even while its gateway runs.

    :raises ConfigError: it is missing, or not a store.
    """
    try:
        base = open_for_inspection(path)
        base.execute("SELECT 1 FROM audit LIMIT 1")
    except FAULTS as error:
        raise ConfigError(_unreadable(path, error)) from None
    return base


def _unreadable(path: Path, error: Exception) -> str:
    """Tell a store that no gateway has served yet from one that cannot be read."""
    if head_beside(path) in (None, (0, GENESIS)):
        if _is_missing(path):
            return (
                f"the store '{path}' does not exist; a gateway creates it when it starts "
                "(`rcpd serve`)"
            )
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_ERROR:  # no such table
            return (
                f"the store '{path}' has no audit log yet; a gateway adds it when it starts "
                "(`rcpd serve`)"
            )
    advice = "; run `rcpd store check`" if is_damage(error) else ""
    return f"the store '{path}' cannot be read: {error}{advice}"


def _is_missing(path: Path) -> bool:
    try:
        path.stat()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return False


def anchor_of(base: sqlite3.Connection) -> Head | None:
    """Return the last deleted record, after which the chain begins."""
    row = base.execute("SELECT value FROM kept WHERE place = 'audit' AND key = 'anchor'").fetchone()
    if row is None:
        return None
    try:
        kept: Any = msgspec.msgpack.decode(row[0])
        return int(kept["seq"]), bytes(kept["hash"])
    except (msgspec.DecodeError, ValueError, TypeError, KeyError):  # the gap reports it
        return None
