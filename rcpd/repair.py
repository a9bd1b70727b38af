"""A store rebuilt from the readable part of a damaged one, its interim file, and a backup.

Records keep their numbers, hashes and bytes. If some are lost, the record of the repair states the
last number that existed. The old files are kept in a folder.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from pathlib import Path

import msgspec

from rcp_kernel.errors import ConfigError
from rcp_store.chain import GENESIS, Head, Row, seal, written
from rcp_store.damage import find_damage, interim_of, known_head
from rcp_store.file import (
    FAULTS,
    HeadFile,
    anchor_of,
    create,
    lock,
    open_for_inspection,
    open_writable,
    store_errors,
)
from rcp_store.interim import SUFFIXES, stamp
from rcp_store.latch_file import GATEWAY, LATCHES, latch_row, latches_beside
from rcp_store.tokens import make_table
from rcpd.recovery import readable_kept, readable_records, readable_tokens

__all__ = ["Repaired", "repair", "restore"]

_ANCHOR = ("audit", "anchor")
_ADD_KEY = (
    "INSERT INTO tokens VALUES (?, ?, ?, ?, ?, ?, ?, ?) "
    "ON CONFLICT DO UPDATE SET revoked = coalesce(revoked, excluded.revoked)"
)


class Repaired(msgspec.Struct):
    """The result of a repair."""

    aside: Path
    """The folder with the old files."""
    records: int
    missing: int
    head: Head
    tokens: int
    apart: bool
    """Whether the interim records are only in that folder, because their numbers are already in
    use."""


def repair(path: Path) -> Repaired | None:
    """Rebuild a damaged store from its readable data; return None if it is not damaged.

    :raises ConfigError: a gateway uses it, or nothing can be written beside it.
    """
    with store_errors(path), closing(lock(path)):
        damage = find_damage(path, bound=None)
        if damage is None:
            return None
        return _Repair(path, f"store repaired: {damage}").run([path], [path])


def restore(path: Path, backup: Path) -> Repaired:
    """Replace a store by a backup, and add later records that are still readable.

    :raises ConfigError: as for `repair`; or the backup is damaged, or of another store.
    """
    with store_errors(path):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with closing(lock(path)):
            _check_backup(path, backup)
            made = _Repair(path, f"store restored from {backup.name}")
            return made.run([backup, path], [backup])


def _check_backup(path: Path, backup: Path) -> None:
    damage = find_damage(backup, bound=None)
    if damage is not None or not backup.exists():
        raise ConfigError(f"the backup '{backup}' is damaged: {damage or 'it does not exist'}")
    head = known_head(backup)
    with suppress(*FAULTS), closing(open_for_inspection(path, tolerant=True)) as base:
        row = base.execute("SELECT hash FROM audit WHERE seq = ?", (head[0],)).fetchone()
        if row is not None and row[0] != head[1]:
            raise ConfigError(
                f"'{backup}' is a backup of another store: record {head[0]} differs. "
                f"To replace it anyway, first move '{path}' and the files beside it away"
            )


class _Repair:
    """The rebuilding of one store beside the damaged one."""

    def __init__(self, path: Path, reason: str) -> None:
        self._path = path
        self._reason = reason
        self._interim = interim_of(path)
        self._fresh = path.with_name(path.name + ".repaired")
        self._aside = path.with_name(f"{path.name}.damaged-{stamp()}")
        self._apart = False

    def run(self, records: list[Path], kept: list[Path]) -> Repaired:
        """Rebuild from the records of some files and the rows of others; put it in place."""
        head = max(map(known_head, (*records, self._interim)))
        for suffix in SUFFIXES:
            self._fresh.with_name(self._fresh.name + suffix).unlink(missing_ok=True)
        create(self._fresh)
        with closing(open_writable(self._fresh)) as base:
            make_table(base)
            for path in records:
                self._take_records(base, path, head[0])
            self._take_interim(base, head[0])
            for path in (*kept, self._interim):
                self._take_kept(base, path)
            for path in (*records, self._interim):
                self._take_tokens(base, path)
            made = self._seal(base, head)
            base.execute("PRAGMA journal_mode=DELETE")
        self._put_in_place(made.head)
        return made

    def _take_records(self, base: sqlite3.Connection, path: Path, last: int) -> None:
        with suppress(*FAULTS), closing(open_for_inspection(path, tolerant=True)) as source, base:
            rows = readable_records(source, last)
            base.executemany("INSERT OR IGNORE INTO audit VALUES (?, ?, ?)", rows)

    def _take_interim(self, base: sqlite3.Connection, last: int) -> None:
        """Add the interim records, unless their numbers are already in use."""
        if not self._interim.exists():
            return
        before = base.execute("SELECT coalesce(max(seq), 0) FROM audit").fetchone()[0]
        with (
            suppress(*FAULTS),
            closing(open_for_inspection(self._interim, tolerant=True)) as source,
        ):
            first = source.execute("SELECT min(seq) FROM audit").fetchone()[0]
            self._apart = first is None or first <= before
        if not self._apart:
            self._take_records(base, self._interim, last)

    def _take_kept(self, base: sqlite3.Connection, path: Path) -> None:
        with suppress(*FAULTS), closing(open_for_inspection(path, tolerant=True)) as source, base:
            for row in readable_kept(source):
                if path != self._interim or row[:2] != _ANCHOR:
                    base.execute("INSERT OR REPLACE INTO kept VALUES (?, ?, ?)", row)

    def _take_tokens(self, base: sqlite3.Connection, path: Path) -> None:
        with suppress(*FAULTS), closing(open_for_inspection(path, tolerant=True)) as source, base:
            for row in readable_tokens(source):
                with suppress(sqlite3.Error):  # a corrupt row authenticates nobody
                    base.execute(_ADD_KEY, row)

    def _seal(self, base: sqlite3.Connection, head: Head) -> Repaired:
        """Add the record of the repair, and an e-stop latch for someone to check the robots."""
        count, last = base.execute("SELECT count(*), coalesce(max(seq), 0) FROM audit").fetchone()
        if last >= head[0]:  # the existing records show best how they end
            head = base.execute("SELECT seq, hash FROM audit WHERE seq = ?", (last,)).fetchone()
            head = head or (0, GENESIS)
        missing = head[0] - (anchor_of(base) or (0, GENESIS))[0] - count
        tokens = base.execute("SELECT count(*) FROM tokens WHERE revoked IS NULL").fetchone()[0]
        row: Row = seal(
            head,
            "repair",
            {
                "head": written(head),
                "records": count,
                "missing": missing,
                "message": self._reason,
                "aside": self._aside.name,
                "apart": self._interim.name if self._apart else None,
            },
        )
        why = f"{self._reason} ({missing} records are missing, and perhaps an e-stop among them)"
        latch = msgspec.msgpack.encode(latch_row("rcpd store", why))
        with base:
            base.execute("INSERT INTO audit VALUES (?, ?, ?)", row)
            base.execute("INSERT OR REPLACE INTO kept VALUES (?, ?, ?)", (LATCHES, GATEWAY, latch))
        return Repaired(self._aside, count, missing, row[:2], tokens, self._apart)

    def _put_in_place(self, head: Head) -> None:
        """Keep the old files, then put the new store in place.

        If it is interrupted in between, the store is still damaged, and the old files are in the
        folder.
        """
        self._aside.mkdir(mode=0o700)
        old = [_named(path, suffix) for path in (self._path, self._interim) for suffix in SUFFIXES]
        for file in (*old, latches_beside(self._path)):
            if file.exists():
                _copy_name(file, self._aside / file.name)
        for suffix in ("-wal", "-shm", "-journal"):  # SQLite would apply them to the new database
            _named(self._path, suffix).unlink(missing_ok=True)
        self._fresh.replace(self._path)
        _named(self._path, ".head").unlink(missing_ok=True)  # it has a second name
        with closing(HeadFile(self._path)) as file:
            file.open(head)
        for suffix in SUFFIXES:
            _named(self._interim, suffix).unlink(missing_ok=True)


def _named(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def _copy_name(file: Path, name: Path) -> None:
    """Give a file a second name, or copy it where hard links are not supported."""
    try:
        name.hardlink_to(file)
    except OSError:
        name.write_bytes(file.read_bytes())
        name.chmod(0o600)
