"""What survives the process: keyed values and the audit's rows in SQLite, written by one thread.

The event loop gathers what is put and hands it over once a turn; the thread writes whatever has
come in one transaction. With WAL and `synchronous=NORMAL` what is committed survives `kill -9`
of the gateway; a power cut may cost the last moments, never the file. Latched e-stops are kept a
second time, in a file of their own that is flushed to the disk.
"""

from __future__ import annotations

import asyncio
import queue
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import msgspec
import structlog

from rcp_kernel.process.modes import check_store_modes
from rcp_kernel.record.chain import Head, Row
from rcp_kernel.record.damage import find_damage, interim_of
from rcp_kernel.record.file import (
    FAULTS,
    ROWS,
    HeadFile,
    create,
    is_damage,
    lock,
    opened,
    prove,
    store_errors,
)
from rcp_kernel.record.interim import open_beside, stamp
from rcp_kernel.record.latch_file import (
    GATEWAY,
    LATCHES,
    LatchFile,
    encode_latches,
    latch_row,
    union,
)
from rcp_kernel.record.presence import Presence, StoreGone
from rcp_kernel.values import Encoding, dump

__all__ = ["DiskStore", "Store"]

log = structlog.get_logger("rcp.store")
_RETRY = 0.5  # s between attempts of a store that cannot write
_LOOK = 1.0  # s between looks whether the files are still there
_OFTEN = 0.1  # s between them while much is written
_CLOSE = 10.0  # s to write what is left
_KEEPER = "the gateway"


class Store:
    """Keeps nothing: the store of a gateway without `[store] path`, and the base of the other."""

    keeps = False
    """Whether anything survives; what is dear to prepare need not be put where nothing does."""
    damage: str | None = None
    """Why the database that is configured is left alone, and another one is written."""
    lost = False
    """Whether something could not be written before the end."""
    trouble: str | None = None
    """Why nothing can be written at present."""
    waiting = 0
    """Rows of the audit that are not committed yet."""
    left: Head | None = None
    """The head of the audit as the earlier run left it beside the database."""
    head: Head | None = None
    """The last row of the audit that this run committed."""

    @property
    def path(self) -> Path | None:
        """The database that is written; it is beside that of the configuration if that is damaged."""
        return None

    def put(self, table: str, key: str, value: Any | None) -> None:
        """Keep a value that msgpack takes under a key; None deletes. Returns at once."""

    def load(self, table: str, *, unreadable: Any = None) -> dict[str, Any]:
        """Return what earlier runs kept in a table. Blocks: for the start only.

        A row that cannot be read counts as `unreadable`; it is left out if that is None.
        """
        return {}

    def append(self, row: Row) -> None:
        """Add a row to the audit. Returns at once."""

    def prune(self, before: int) -> None:
        """Delete the audit's rows before a number. Returns at once."""

    def rows(self, last: int) -> list[Row]:
        """Return the last rows of the audit that earlier runs left. Blocks: for the start only."""
        return []

    @property
    def idle(self) -> bool:
        """Whether all that was put is committed."""
        return True

    def settled(self, callback: Callable[[], object]) -> None:
        """Call back on the event loop once all that was put before is committed."""
        callback()

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Have the store's thread look something up; `then` gets it on the event loop."""

    def close(self) -> None:
        """Write what is left, then stop."""


class _Batch:
    """What one transaction writes."""

    __slots__ = ("before", "latches", "looks", "puts", "rows", "upto")

    def __init__(self) -> None:
        self.latches: bytes | None = None
        """What the latch file is to hold, if a latch has changed."""
        self.looks: list[tuple[Callable[[sqlite3.Connection], Any], Callable[[Any], None]]] = []
        self.puts: dict[tuple[str, str], bytes | None] = {}
        self.rows: list[Row] = []
        self.before = 0
        self.upto = 0

    def take(self, later: _Batch) -> None:
        self.puts.update(later.puts)
        self.rows += later.rows
        self.looks += later.looks
        self.latches = later.latches or self.latches
        self.before = max(self.before, later.before)
        self.upto = later.upto


class DiskStore(Store):
    """A store in one SQLite file. For the event loop's thread, which it never blocks."""

    keeps = True

    def __init__(self, path: Path, loop: asyncio.AbstractEventLoop) -> None:
        """Open or create the database, or one beside it if it is damaged.

        :raises ConfigError: it cannot be opened, or another gateway has it.
        """
        self._path = path
        self._loop = loop
        self._gathered = _Batch()
        self._scheduled = False
        self._count = 0
        self._committed = 0
        self._waiters: deque[tuple[int, Callable[[], object]]] = deque()
        self._queue: queue.SimpleQueue[_Batch | None] = queue.SimpleQueue()
        self._next_look = 0.0
        self._latches_changed = False
        self._latches: dict[str, Any] = {}
        """The latches as they are to be kept."""
        self._latch_file = LatchFile(path)
        with store_errors(path), ExitStack() as opening:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if (warning := check_store_modes(path)) is not None:
                log.warning("store_readable", path=str(path), message=warning)
            self._lock = lock(path)
            opening.callback(self._lock.close)
            self._open(opening)
            self._presence = Presence(self.path)
            unkept = self._find_latches()
            opening.pop_all()
        self._thread = threading.Thread(target=self._write, name="rcp-store", daemon=True)
        self._thread.start()
        for key in unkept:
            self.put(LATCHES, key, self._latches[key])

    @property
    def path(self) -> Path:
        """The database that is written."""
        return self._path

    def _open(self, opening: ExitStack) -> None:
        """Open the database, or another one if it is damaged."""
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
        self._head.open()  # before the database: without one beside it, nothing tells of its end
        opening.callback(self._head.close)
        if not self.path.exists():
            create(self.path)
        with closing(self._connect()) as base:
            prove(base)

    def _find_latches(self) -> list[str]:
        """Find the latches of earlier runs, in both places; return those the database has not.

        Where one of the places is damaged, every robot is latched: somebody may have done so.
        """
        why = None if self.damage is None else f"store damaged: {self.damage}"
        found = None
        try:
            found = self._latch_file.read()
        except ValueError as error:
            why = why or f"store damaged: {self._latch_file.path.name}: {error}"
            aside = self._latch_file.put_aside(stamp())
            log.error("latches_damaged", path=str(aside), detail=str(error))
        kept = self._kept(LATCHES, {})
        self._latches = union(kept, found or {})
        if why is not None:
            self._latches[GATEWAY] = _held(self._latches.get(GATEWAY), why)
        if found != self._latches:
            self._latch_file.write(encode_latches(self._latches))
        return [key for key, latch in self._latches.items() if kept.get(key) != latch]

    def _connect(self) -> sqlite3.Connection:
        return opened(self.path)

    # -- the event loop's side -----------------------------------------------------------------

    def put(self, table: str, key: str, value: Any | None) -> None:
        """Keep a value, or delete it."""
        data = None
        try:
            key.encode()  # what SQLite would not take must not keep the rest of its batch out
            if value is not None:
                data = _encoded(value)
        except Exception:  # what it tells of goes on, whether it can be written down or not
            log.exception("store_failed", table=table, key=key)
            return
        self._gathered.puts[table, key] = data
        if table == LATCHES:
            self._latches_changed = True
            if value is None:
                self._latches.pop(key, None)
            else:
                self._latches[key] = value
        self._gather()

    def append(self, row: Row) -> None:
        """Add a row to the audit."""
        self._gathered.rows.append(row)
        self.waiting += 1
        self._gather()

    def prune(self, before: int) -> None:
        """Delete the audit's rows before a number."""
        self._gathered.before = before
        self._gather()

    def _gather(self) -> None:
        self._count += 1
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self._hand_over)

    def _hand_over(self) -> None:
        self._scheduled = False
        batch, self._gathered = self._gathered, _Batch()
        batch.upto = self._count
        if self._latches_changed:
            self._latches_changed = False
            batch.latches = encode_latches(self._latches)
        self._queue.put(batch)

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Have the thread look something up once all that was put before is committed."""
        self._gathered.looks.append((work, then))
        self._gather()

    @property
    def idle(self) -> bool:
        """Whether all that was put is committed."""
        return self._committed == self._count

    def settled(self, callback: Callable[[], object]) -> None:
        """Call back once all that was put before is committed."""
        if self.idle:
            callback()
        else:
            self._waiters.append((self._count, callback))

    def _written(self, batch: _Batch, found: list[Any]) -> None:
        upto = self._committed = batch.upto
        self.waiting -= len(batch.rows)
        self.trouble = None
        if batch.rows:
            self.head = batch.rows[-1][:2]
        for (_, then), result in zip(batch.looks, found, strict=True):
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

    def _found_again(self) -> None:
        if self.idle:
            self.trouble = None

    def load(self, table: str, *, unreadable: Any = None) -> dict[str, Any]:
        """Return what earlier runs kept in a table; latches from both places that they are kept in.

        :raises ConfigError: the database cannot be read.
        """
        if table == LATCHES:
            return dict(self._latches)
        return self._kept(table, unreadable)

    def _kept(self, table: str, unreadable: Any) -> dict[str, Any]:
        with store_errors(self.path), closing(self._connect()) as base:
            rows = base.execute("SELECT key, value FROM kept WHERE place = ?", (table,)).fetchall()
        found = {key: _decoded(table, key, data, unreadable) for key, data in rows}
        return {key: value for key, value in found.items() if value is not None}

    def rows(self, last: int) -> list[Row]:
        """Return the audit's last rows, oldest first.

        :raises ConfigError: the database cannot be read.
        """
        with store_errors(self.path), closing(self._connect()) as base:
            return base.execute(f"{ROWS} ORDER BY seq DESC LIMIT ?", (last,)).fetchall()[::-1]

    def close(self) -> None:
        """Write what is left within a bound, then stop."""
        self._hand_over()
        self._queue.put(None)
        self._thread.join(timeout=_CLOSE)
        if self._thread.is_alive():
            self.lost = True
            log.error("store_lost", path=str(self.path), detail="the disk does not respond")
        else:
            self._head.close()
        self._lock.close()

    # -- the thread's side ---------------------------------------------------------------------

    def _write(self) -> None:
        base: sqlite3.Connection | None = None
        batch, ending = _Batch(), False
        while not ending:
            ending = self._collect(batch, _LOOK)
            if batch.upto == 0:
                self._look_after_files()
            while batch.upto > 0:
                try:
                    base = self._commit(base, batch)
                    found = [_looked(base, work) for work, _ in batch.looks]
                except Exception as error:  # whatever it was: nothing may end what keeps the record
                    self._tell(self._failed, str(error))
                    base = self._let_go(base, error)
                    if ending:
                        self.lost = True
                        log.error("store_lost", path=str(self.path), rows=len(batch.rows))
                        return
                    ending = self._wait_out(batch)
                else:
                    self._tell(self._written, batch, found)
                    batch = _Batch()
        if base is not None:
            base.close()

    def _collect(self, batch: _Batch, within: float) -> bool:
        """Take in what has gathered or comes soon; return whether that was all there will ever be."""
        with suppress(queue.Empty):
            more = self._queue.get(timeout=within)
            while more is not None:
                batch.take(more)
                more = self._queue.get_nowait()
            return True
        return False

    def _wait_out(self, batch: _Batch) -> bool:
        """Collect for a while before the next attempt; latches are kept at once even then."""
        end = time.monotonic() + _RETRY
        while (left := end - time.monotonic()) > 0:
            if self._collect(batch, left):
                return True
            with suppress(OSError):  # the next attempt tells of it
                self._save_latches(batch)
        return False

    def _commit(self, base: sqlite3.Connection | None, batch: _Batch) -> sqlite3.Connection:
        """Write a batch to where it belongs; the latch file first, which is there in any case.

        :raises Exception: not all of it could be.
        """
        unsaved: OSError | None = None
        try:
            self._save_latches(batch)
        except OSError as error:
            unsaved = error
        fresh = base is None
        self._check_files(at_once=fresh)  # before anything is made in their place
        base = base or self._connect()
        _commit(base, batch)
        if fresh:
            self._presence.learn()
        self._write_head(batch)
        if unsaved is not None:
            raise OSError(f"the latches cannot be kept beside the database: {unsaved}")
        return base

    def _save_latches(self, batch: _Batch) -> None:
        if batch.latches is not None:
            self._latch_file.write(batch.latches)
            batch.latches = None

    def _let_go(
        self, base: sqlite3.Connection | None, error: Exception
    ) -> sqlite3.Connection | None:
        """Close a database that has failed, so that it is opened anew."""
        if isinstance(error, StoreGone):
            return base  # its files are expected back; others would not be its own
        if base is not None:
            base.close()
        self._presence.forget()
        return None

    def _check_files(self, *, at_once: bool = False) -> None:
        """Look whether the files are still there, if that is due.

        :raises StoreGone: one is not.
        """
        moment = time.monotonic()
        if at_once or moment >= self._next_look:
            self._presence.check()
            self._head.stay()
            self._next_look = moment + _OFTEN

    def _look_after_files(self) -> None:
        try:
            self._check_files()
        except OSError as error:
            self._tell(self._failed, str(error))
        else:
            if self.trouble is not None:
                self._tell(self._found_again)

    def _write_head(self, batch: _Batch) -> None:
        """Keep the head in a second place, where the end of the chain can be missed."""
        if batch.rows:
            with suppress(OSError):  # what is committed is committed
                self._head.write(batch.rows[-1][:2])

    def _tell(self, what: Callable[..., None], *facts: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended: nobody waits any more
            self._loop.call_soon_threadsafe(what, *facts)


def _commit(base: sqlite3.Connection, batch: _Batch) -> None:
    kept = [(place, key, data) for (place, key), data in batch.puts.items() if data is not None]
    gone = [key for key, data in batch.puts.items() if data is None]
    with base:
        base.executemany("INSERT OR REPLACE INTO kept VALUES (?, ?, ?)", kept)
        base.executemany("DELETE FROM kept WHERE place = ? AND key = ?", gone)
        base.executemany("INSERT OR REPLACE INTO audit VALUES (?, ?, ?)", batch.rows)
        if batch.before:
            base.execute("DELETE FROM audit WHERE seq < ?", (batch.before,))


def _looked(base: sqlite3.Connection, work: Callable[[sqlite3.Connection], Any]) -> Any:
    try:
        return work(base)
    except Exception:  # nobody's question may end the thread that writes
        log.exception("store_look_failed")
        return None


def _encoded(value: Any) -> bytes:
    try:
        return msgspec.msgpack.encode(value)
    except OverflowError:  # an integer past 64 bits: a text, as on the wire
        return msgspec.msgpack.encode(msgspec.json.decode(dump(value, Encoding.JSON)))


def _decoded(table: str, key: str, data: bytes, unreadable: Any) -> Any:
    try:
        return msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, TypeError, ValueError) as error:
        log.warning("store_row_unreadable", table=table, key=key, error=str(error))
        return unreadable


def _held(latch: dict[str, Any] | None, why: str) -> dict[str, Any]:
    """Return the latch that holds every robot, with what is known of an older one."""
    if latch and latch.get("by") != _KEEPER:
        why += f"; latched already by {latch.get('by')}: {latch.get('reason')}"
    return latch_row(_KEEPER, why)


def _way_out(interim: Path) -> str:
    return (
        f"every robot is latched and audit records go to {interim.name}; stop the gateway, then "
        "run `rcpd store repair`, or `rcpd store restore` with a backup"
    )
