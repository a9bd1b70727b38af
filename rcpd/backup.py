"""A backup of a store, also while its gateway writes to it."""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import closing
from pathlib import Path

from rcp_kernel.errors import ConfigError
from rcp_store.chain import GENESIS
from rcp_store.damage import find_damage
from rcp_store.file import HeadFile, open_read_only, store_errors
from rcpd.examination import examined
from rcpd.verification import Verdict

__all__ = ["check_whole", "copied", "make_backup"]

_PAGES = 256  # pages copied at once
_PAUSE = 0.002  # s between them: the gateway has priority for the disk


def make_backup(path: Path, target: Path) -> Verdict:
    """Copy a store to a file that is verified before it gets its name; return the verdict.

    The copy is a consistent snapshot. Readers do not block the writer; only the WAL grows until the
    copy is finished.

    :raises ConfigError: the store is damaged or cannot be read, or the file already exists.
    """
    if target.exists():
        raise ConfigError(f"'{target}' already exists: choose another name for the backup")
    with store_errors(path):
        damage = find_damage(path)
    if damage is not None:
        raise ConfigError(f"the store '{path}' is damaged: {damage}. Run `rcpd store repair` first")
    part = target.with_name(target.name + ".part")
    head = HeadFile(path).read() or (0, GENESIS)  # before the copy, which must contain it
    try:
        copied(path, part)
        verdict = check_whole(part)
        if verdict.head[0] < head[0]:
            raise ConfigError(
                f"'{part}' ends before record {head[0]}: it is not a copy of '{path}'"
            )
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    with closing(HeadFile(target)) as beside:
        beside.open()
        beside.write(verdict.head)
    part.replace(target)
    return verdict


def copied(path: Path, target: Path) -> None:
    """Copy a database into one file without side files, and flush it to disk.

    :raises ConfigError: it cannot be read, or the copy cannot be written.
    """
    with closing(open_read_only(path)) as source, store_errors(target):
        target.unlink(missing_ok=True)
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        source.execute("BEGIN")
        source.execute("SELECT count(*) FROM sqlite_master").fetchall()  # takes one snapshot
        with closing(sqlite3.connect(target)) as copy:
            source.backup(copy, pages=_PAGES, progress=_pause)
            copy.execute("PRAGMA journal_mode=DELETE")
        place = os.open(target, os.O_RDONLY)
        try:
            os.fsync(place)
        finally:
            os.close(place)


def _pause(_status: int, _left: int, _pages: int) -> None:
    time.sleep(_PAUSE)


def check_whole(path: Path) -> Verdict:
    """Check every page of a database and every record; return the verdict on its chain.

    :raises ConfigError: SQLite finds damage.
    """
    with closing(open_read_only(path)) as base, store_errors(path):
        [(found,)] = base.execute("PRAGMA integrity_check(1)").fetchmany(1)
    if found != "ok":
        raise ConfigError(f"'{path}' is damaged: {found}")
    return examined(path)
