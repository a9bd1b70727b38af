"""Persistent keyed values and audit rows in SQLite, written by one thread.

The event loop collects changes and passes them on once per iteration; the thread writes everything
pending in one transaction. With WAL and `synchronous=NORMAL`, committed data survives `kill -9`
of the gateway; a power failure may lose the last moments, never the file. Latched e-stops are also
stored in a separate file that is synced to disk.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import msgspec
import structlog

from rcp_protocol.values import Encoding, dump
from rcp_store.chain import Row
from rcp_store.damage import find_damage, interim_of
from rcp_store.file import (
    FAULTS,
    ROWS,
    HeadFile,
    check_usable,
    create,
    is_damage,
    lock,
    open_writable,
    store_errors,
)
from rcp_store.interim import open_beside, stamp
from rcp_store.latch_file import (
    GATEWAY,
    LATCHES,
    LatchFile,
    encode_latches,
    latch_row,
    union,
)
from rcp_store.modes import check_store_modes
from rcp_store.record_batch import Batch
from rcp_store.store import Store
from rcp_store.store_writer import Reports, StoreWriter

__all__ = ["DiskStore"]

log = structlog.get_logger("rcp.store")
_KEEPER = "the gateway"


class DiskStore(Store):
    """A store in one SQLite file. Use it on the event loop's thread; only loading blocks."""

    keeps = True

    def __init__(self, path: Path, loop: asyncio.AbstractEventLoop) -> None:
        """Open or create the database, or an interim one if it is damaged.

        :raises ConfigError: it cannot be opened, or another gateway uses it.
        """
        self._path = path
        self._loop = loop
        self._gathered = Batch()
        self._scheduled = False
        self._count = 0
        self._committed = 0
        self._waiters: deque[tuple[int, Callable[[], object]]] = deque()
        self._latches_changed = False
        self._latches: dict[str, Any] = {}
        """The latches to store."""
        self._latch_file = LatchFile(path)
        with store_errors(path), ExitStack() as opening:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if (warning := check_store_modes(path)) is not None:
                log.warning("store_readable", path=str(path), message=warning)
            self._lock = lock(path)
            opening.callback(self._lock.close)
            self._open(opening)
            unsaved = self._find_latches()
            opening.pop_all()
        reports = Reports(self._written, self._failed, self._recovered)
        self._writer = StoreWriter(
            self.path, self._connect, self._head, self._latch_file, loop, reports
        )
        self._writer.start()
        for key in unsaved:
            self.put(LATCHES, key, self._latches[key])

    @property
    def path(self) -> Path:
        """The database that is written."""
        return self._path

    def _open(self, opening: ExitStack) -> None:
        """Open the database, or the interim one if it is damaged."""
        path = self.path
        try:
            self.damage = find_damage(path)
            if self.damage is None:
                self._begin(opening)
                return
        except FAULTS as error:
            if not is_damage(error):
                raise
            self.damage = f"the database cannot be read ({error})"
        self._path = interim_of(path)
        log.error("store_damaged", path=str(path), detail=self.damage, remedy=_way_out(self.path))
        open_beside(path, self.path, self.damage)
        self._begin(opening)

    def _begin(self, opening: ExitStack) -> None:
        self._head = HeadFile(self.path)
        self.left = self._head.read()
        self._head.open()  # before the database: a truncation could not be detected without it
        opening.callback(self._head.close)
        if not self.path.exists():
            create(self.path)
        with closing(self._connect()) as base:
            check_usable(base)

    def _find_latches(self) -> list[str]:
        """Load the latches of earlier runs from both copies; return those missing in the database.

        If a copy is damaged, every robot is latched, because the lost part may have been a latch.
        """
        why = None if self.damage is None else f"store damaged: {self.damage}"
        saved = None
        try:
            saved = self._latch_file.read()
        except ValueError as error:
            why = why or f"store damaged: {self._latch_file.path.name}: {error}"
            aside = self._latch_file.put_aside(stamp())
            log.error("latches_damaged", path=str(aside), detail=str(error))
        kept = self._kept(LATCHES, {})
        self._latches = union(kept, saved or {})
        if why is not None:
            self._latches[GATEWAY] = _held(self._latches.get(GATEWAY), why)
        if saved != self._latches:
            self._latch_file.write(encode_latches(self._latches))
        return [key for key, latch in self._latches.items() if kept.get(key) != latch]

    def _connect(self) -> sqlite3.Connection:
        return open_writable(self.path)

    # -- on the event loop ---------------------------------------------------------------------

    def put(self, table: str, key: str, value: Any | None) -> None:
        """Store a value, or delete it."""
        data = None
        try:
            key.encode()  # SQLite would refuse the whole batch because of it
            if value is not None:
                data = _encoded(value)
        except Exception:  # the caller continues whether or not it can be stored
            log.exception("store_failed", table=table, key=key)
            return
        self._gathered.puts[table, key] = data
        if table == LATCHES:
            self._latches_changed = True
            if value is None:
                self._latches.pop(key, None)
            else:
                self._latches[key] = value
        self._count += 1
        self._gather()

    def append(self, row: Row) -> None:
        """Add a row to the audit."""
        self._gathered.rows.append(row)
        self.waiting += 1
        self._count += 1
        if not self._scheduled:
            self._gather()

    def prune(self, before: int) -> None:
        """Delete the audit's rows before a number."""
        self._gathered.before = before
        self._count += 1
        self._gather()

    def _gather(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self._hand_over)

    def _hand_over(self) -> None:
        self._scheduled = False
        batch, self._gathered = self._gathered, Batch()
        batch.upto = self._count
        if self._latches_changed:
            self._latches_changed = False
            batch.latches = encode_latches(self._latches)
        self._writer.put(batch)

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Run a query on the thread once everything put so far is committed."""
        self._gathered.looks.append((work, then))
        self._count += 1
        self._gather()

    @property
    def idle(self) -> bool:
        """Whether everything is committed."""
        return self._committed == self._count

    def settled(self, callback: Callable[[], object]) -> None:
        """Call back once everything put so far is committed."""
        if self._committed == self._count:
            callback()
        else:
            self._waiters.append((self._count, callback))

    def _written(self, batch: Batch, results: list[Any]) -> None:
        upto = self._committed = batch.upto
        self.waiting -= len(batch.rows)
        self.trouble = None
        if batch.rows:
            self.head = batch.rows[-1][:2]
        for (_, then), result in zip(batch.looks, results, strict=True):
            then(result)
        while self._waiters and self._waiters[0][0] <= upto:
            callback = self._waiters.popleft()[1]
            try:
                callback()
            except Exception:
                log.exception("store_callback_failed")

    def _failed(self, reason: str) -> None:
        if self.trouble is None:
            log.error("store_failed", path=str(self.path), error=reason)
        self.trouble = reason

    def _recovered(self) -> None:
        if self.idle:
            self.trouble = None

    def load(self, table: str, *, unreadable: Any = None) -> dict[str, Any]:
        """Return what earlier runs stored in a table; latches are merged from both copies.

        :raises ConfigError: the database cannot be read.
        """
        if table == LATCHES:
            return dict(self._latches)
        return self._kept(table, unreadable)

    def _kept(self, table: str, unreadable: Any) -> dict[str, Any]:
        with store_errors(self.path), closing(self._connect()) as base:
            rows = base.execute("SELECT key, value FROM kept WHERE place = ?", (table,)).fetchall()
        values = {key: _decoded(table, key, data, unreadable) for key, data in rows}
        return {key: value for key, value in values.items() if value is not None}

    def rows(self, last: int) -> list[Row]:
        """Return the audit's last rows, oldest first.

        :raises ConfigError: the database cannot be read.
        """
        with store_errors(self.path), closing(self._connect()) as base:
            return base.execute(f"{ROWS} ORDER BY seq DESC LIMIT ?", (last,)).fetchall()[::-1]

    def close(self) -> None:
        """Write the rest within a time limit, then stop."""
        self._hand_over()
        self.lost = not self._writer.close()
        self._lock.close()


def _encoded(value: Any) -> bytes:
    try:
        return msgspec.msgpack.encode(value)
    except OverflowError:  # an integer beyond 64 bits becomes a string, as on the wire
        return msgspec.msgpack.encode(msgspec.json.decode(dump(value, Encoding.JSON)))


def _decoded(table: str, key: str, data: bytes, unreadable: Any) -> Any:
    try:
        return msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, TypeError, ValueError) as error:
        log.warning("store_row_unreadable", table=table, key=key, error=str(error))
        return unreadable


def _held(latch: dict[str, Any] | None, why: str) -> dict[str, Any]:
    """Return a gateway-wide latch whose reason mentions an older one."""
    if latch and latch.get("by") != _KEEPER:
        why += f"; latched already by {latch.get('by')}: {latch.get('reason')}"
    return latch_row(_KEEPER, why)


def _way_out(interim: Path) -> str:
    return (
        f"every robot is latched and audit records go to {interim.name}; stop the gateway, then "
        "run `rcpd store repair`, or `rcpd store restore` with a backup"
    )
