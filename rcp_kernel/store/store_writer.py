"""The thread that writes the store: whatever has gathered in one transaction, again until it can."""

from __future__ import annotations

import asyncio
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import structlog

from rcp_kernel.store.file import HeadFile
from rcp_kernel.store.latch_file import LatchFile
from rcp_kernel.store.presence import Presence, StoreGone
from rcp_kernel.store.record_batch import Batch, commit, looked_up

__all__ = ["Reports", "StoreWriter"]

log = structlog.get_logger("rcp.store")
_RETRY = 0.5  # s between attempts of a store that cannot write
_LOOK = 1.0  # s between looks whether the files are still there
_OFTEN = 0.1  # s between them while much is written
_CLOSE = 10.0  # s to write what is left


class Reports(NamedTuple):
    """What the writer calls on the event loop."""

    written: Callable[[Batch, list[Any]], None]
    """With a batch that is committed, and what its look-ups found."""
    failed: Callable[[str], None]
    """With the reason why nothing can be written at present."""
    found_again: Callable[[], None]
    """After a failure, when the files are there."""


class StoreWriter:
    """Takes batches and writes them in their order."""

    def __init__(
        self,
        path: Path,
        connect: Callable[[], sqlite3.Connection],
        head: HeadFile,
        latch_file: LatchFile,
        loop: asyncio.AbstractEventLoop,
        reports: Reports,
    ) -> None:
        self._path = path
        self._connect = connect
        self._head = head
        self._latch_file = latch_file
        self._loop = loop
        self._reports = reports
        self._presence = Presence(path)
        self._queue: queue.SimpleQueue[Batch | None] = queue.SimpleQueue()
        self._next_look = 0.0
        self._failing = False
        self._lost = False
        self._thread = threading.Thread(target=self._write, name="rcp-store", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Have a batch written. Returns at once."""
        self._queue.put(batch)

    def close(self) -> bool:
        """Write what is left within a bound, then stop; return whether all is written."""
        self._queue.put(None)
        self._thread.join(timeout=_CLOSE)
        if self._thread.is_alive():
            log.error("store_lost", path=str(self._path), detail="the disk does not respond")
            return False
        self._head.close()
        return not self._lost

    # -- the thread's side ---------------------------------------------------------------------

    def _write(self) -> None:
        base: sqlite3.Connection | None = None
        batch, ending = Batch(), False
        while not ending:
            ending = self._collect(batch, _LOOK)
            if batch.upto == 0:
                self._look_after_files()
            while batch.upto > 0:
                try:
                    base = self._commit(base, batch)
                    found = [looked_up(base, work) for work, _ in batch.looks]
                except Exception as error:  # whatever it was: nothing may end what keeps the record
                    self._fail(str(error))
                    base = self._let_go(base, error)
                    if ending:
                        self._lost = True
                        log.error("store_lost", path=str(self._path), rows=len(batch.rows))
                        return
                    ending = self._wait_out(batch)
                else:
                    self._failing = False
                    self._tell(self._reports.written, batch, found)
                    batch = Batch()
        if base is not None:
            base.close()

    def _collect(self, batch: Batch, within: float) -> bool:
        """Take in what has gathered or comes soon; return whether that was all there will ever be."""
        with suppress(queue.Empty):
            more = self._queue.get(timeout=within)
            while more is not None:
                batch.take(more)
                more = self._queue.get_nowait()
            return True
        return False

    def _wait_out(self, batch: Batch) -> bool:
        """Collect for a while before the next attempt; latches are kept at once even then."""
        end = time.monotonic() + _RETRY
        while (left := end - time.monotonic()) > 0:
            if self._collect(batch, left):
                return True
            with suppress(OSError):  # the next attempt tells of it
                self._save_latches(batch)
        return False

    def _commit(self, base: sqlite3.Connection | None, batch: Batch) -> sqlite3.Connection:
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
        commit(base, batch)
        if fresh:
            self._presence.learn()
        self._write_head(batch)
        if unsaved is not None:
            raise OSError(f"the latches cannot be kept beside the database: {unsaved}")
        return base

    def _save_latches(self, batch: Batch) -> None:
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
            self._fail(str(error))
        else:
            if self._failing:
                self._tell(self._reports.found_again)

    def _write_head(self, batch: Batch) -> None:
        """Keep the head in a second place, where the end of the chain can be missed."""
        if batch.rows:
            with suppress(OSError):  # what is committed is committed
                self._head.write(batch.rows[-1][:2])

    def _fail(self, reason: str) -> None:
        self._failing = True
        self._tell(self._reports.failed, reason)

    def _tell(self, what: Callable[..., None], *facts: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended: nobody waits any more
            self._loop.call_soon_threadsafe(what, *facts)
