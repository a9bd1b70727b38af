"""What survives the process: keyed values and the audit's rows in SQLite, written by one thread.

The event loop gathers what is put and hands it over once a turn; the thread writes whatever has
come in one transaction. With WAL and `synchronous=NORMAL` what is committed survives `kill -9`
of the gateway; a power cut may cost the last moments, never the file.
"""

from __future__ import annotations

import asyncio
import os
import queue
import sqlite3
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import msgspec
import structlog

from rcp_kernel.process.modes import check_store_modes
from rcp_kernel.record.chain import Head, Row
from rcp_kernel.record.file import (
    ROWS,
    beside,
    create,
    head_beside,
    lock,
    opened,
    prove,
    store_errors,
)
from rcp_kernel.values import Encoding, dump

__all__ = ["DiskStore", "Store"]

log = structlog.get_logger("rcp.store")
_RETRY = 0.5  # s between attempts of a store that cannot write


class Store:
    """Keeps nothing: the store of a gateway without `[store] path`, and the base of the other."""

    keeps = False
    """Whether anything survives; what is dear to prepare need not be put where nothing does."""
    trouble: str | None = None
    """Why nothing can be written at present."""
    waiting = 0
    """Rows of the audit that are not committed yet."""
    left: Head | None = None
    """The head of the audit as the earlier run left it beside the database."""
    head: Head | None = None
    """The last row of the audit that this run committed."""

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

    __slots__ = ("before", "looks", "puts", "rows", "upto")

    def __init__(self) -> None:
        self.looks: list[tuple[Callable[[sqlite3.Connection], Any], Callable[[Any], None]]] = []
        self.puts: dict[tuple[str, str], bytes | None] = {}
        self.rows: list[Row] = []
        self.before = 0
        self.upto = 0

    def take(self, later: _Batch) -> None:
        self.puts.update(later.puts)
        self.rows += later.rows
        self.looks += later.looks
        self.before = max(self.before, later.before)
        self.upto = later.upto


class DiskStore(Store):
    """A store in one SQLite file. For the event loop's thread, which it never blocks."""

    keeps = True

    def __init__(self, path: Path, loop: asyncio.AbstractEventLoop) -> None:
        """Open or create the database.

        :raises ConfigError: it cannot be opened, or another gateway has it.
        """
        self.path = path
        self._loop = loop
        self._gathered = _Batch()
        self._scheduled = False
        self._count = 0
        self._committed = 0
        self._waiters: deque[tuple[int, Callable[[], object]]] = deque()
        self._queue: queue.SimpleQueue[_Batch | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        with store_errors(path), ExitStack() as opening:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if (warning := check_store_modes(path)) is not None:
                log.warning("store_readable", path=str(path), message=warning)
            self._lock = lock(path)
            opening.callback(self._lock.close)
            if not path.exists():
                create(path)
            self.left = head_beside(path)
            self._beside = os.open(beside(path), os.O_CREAT | os.O_WRONLY, 0o600)
            opening.callback(os.close, self._beside)
            with closing(self._connect()) as base:
                prove(base)
            opening.pop_all()
        self._thread = threading.Thread(target=self._write, name="rcp-store", daemon=True)
        self._thread.start()

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

    def load(self, table: str, *, unreadable: Any = None) -> dict[str, Any]:
        """Return what earlier runs kept in a table.

        :raises ConfigError: the database cannot be read.
        """
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
        self._closing.set()
        self._thread.join(timeout=10)
        self._lock.close()
        os.close(self._beside)

    # -- the thread's side ---------------------------------------------------------------------

    def _write(self) -> None:
        base: sqlite3.Connection | None = None
        batch, ending = _Batch(), False
        while not ending:
            ending = self._collect(batch)
            while batch.upto > 0:
                try:
                    base = base or self._connect()
                    _commit(base, batch)
                    self._write_beside(batch)
                    found = [_looked(base, work) for work, _ in batch.looks]
                except Exception as error:  # whatever it was: nothing may end what keeps the record
                    self._tell(self._failed, str(error))
                    if base is not None:
                        base.close()
                        base = None
                    if self._closing.wait(_RETRY):
                        log.error("store_lost", path=str(self.path), rows=len(batch.rows))
                        return
                    ending = self._collect(batch, wait=False)
                else:
                    self._tell(self._written, batch, found)
                    batch = _Batch()
        if base is not None:
            base.close()

    def _collect(self, batch: _Batch, *, wait: bool = True) -> bool:
        """Take in what has gathered; return whether that was all there will ever be."""
        while wait or not self._queue.empty():
            wait = False
            more = self._queue.get()
            if more is None:
                return True
            batch.take(more)
        return False

    def _write_beside(self, batch: _Batch) -> None:
        """Keep the head in a second place, where the end of the chain can be missed."""
        if batch.rows:
            seq, digest, _ = batch.rows[-1]
            with suppress(OSError):  # what is committed is committed
                os.lseek(self._beside, 0, os.SEEK_SET)
                os.write(self._beside, f"{seq:020d}:{digest.hex()}\n".encode())

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
