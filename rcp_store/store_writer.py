"""The thread that writes the store: all pending changes in one transaction, retried on failure."""

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

from rcp_store.file import HeadFile
from rcp_store.latch_file import LatchFile
from rcp_store.presence import Presence, StoreGone
from rcp_store.record_batch import Batch, commit, run_query

__all__ = ["Reports", "StoreWriter"]

log = structlog.get_logger("rcp.store")
_RETRY = 0.5  # s between attempts after a failure
_LOOK = 1.0  # s between checks that the files still exist
_OFTEN = 0.1  # s between these checks during continuous writes
_CLOSE = 10.0  # s to write the rest at the end


class Reports(NamedTuple):
    """The writer's callbacks, called on the event loop."""

    written: Callable[[Batch, list[Any]], None]
    """Called with a committed batch and the results of its queries."""
    failed: Callable[[str], None]
    """Called with the reason why writing fails."""
    recovered: Callable[[], None]
    """Called after a failure, when the files exist again."""


class StoreWriter:
    """Writes batches in order."""

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
        """Start the thread."""
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Queue a batch. Returns at once."""
        self._queue.put(batch)

    def close(self) -> bool:
        """Write the rest within a time limit, then stop; return whether everything was written."""
        self._queue.put(None)
        self._thread.join(timeout=_CLOSE)
        if self._thread.is_alive():
            log.error("store_lost", path=str(self._path), detail="the disk does not respond")
            return False
        self._head.close()
        return not self._lost

    # -- in the thread -------------------------------------------------------------------------

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
                    results = [run_query(base, work) for work, _ in batch.looks]
                except Exception as error:  # nothing may end the thread
                    self._fail(str(error))
                    base = self._after_failure(base, error)
                    if ending:
                        self._lost = True
                        log.error("store_lost", path=str(self._path), rows=len(batch.rows))
                        return
                    ending = self._wait_out(batch)
                else:
                    self._failing = False
                    self._tell(self._reports.written, batch, results)
                    batch = Batch()
        if base is not None:
            base.close()

    def _collect(self, batch: Batch, within: float) -> bool:
        """Collect queued batches, waiting `within` seconds; return whether the writer is closing."""
        with suppress(queue.Empty):
            more = self._queue.get(timeout=within)
            while more is not None:
                batch.take(more)
                more = self._queue.get_nowait()
            return True
        return False

    def _wait_out(self, batch: Batch) -> bool:
        """Collect batches until the next attempt; latches are still saved at once."""
        end = time.monotonic() + _RETRY
        while (left := end - time.monotonic()) > 0:
            if self._collect(batch, left):
                return True
            with suppress(OSError):  # the next attempt reports it
                self._save_latches(batch)
        return False

    def _commit(self, base: sqlite3.Connection | None, batch: Batch) -> sqlite3.Connection:
        """Write a batch; the latch file first, because it can be written in any case.

        :raises Exception: a part could not be written.
        """
        unsaved: OSError | None = None
        try:
            self._save_latches(batch)
        except OSError as error:
            unsaved = error
        fresh = base is None
        self._check_files(at_once=fresh)  # before new files are created in their place
        if base is None:
            base = self._connect()
            base.isolation_level = None  # `commit` begins its transactions itself
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

    def _after_failure(
        self, base: sqlite3.Connection | None, error: Exception
    ) -> sqlite3.Connection | None:
        """Close the database after an error, so that it is reopened."""
        if isinstance(error, StoreGone):
            return base  # wait for the original files to come back
        if base is not None:
            base.close()
        self._presence.forget()
        return None

    def _check_files(self, *, at_once: bool = False) -> None:
        """Check that the files still exist, if a check is due.

        :raises StoreGone: one was deleted, replaced or truncated.
        """
        moment = time.monotonic()
        if at_once or moment >= self._next_look:
            self._presence.check()
            self._head.restore()
            self._next_look = moment + _OFTEN

    def _look_after_files(self) -> None:
        try:
            self._check_files()
        except OSError as error:
            self._fail(str(error))
        else:
            if self._failing:
                self._tell(self._reports.recovered)

    def _write_head(self, batch: Batch) -> None:
        """Save a second copy of the head, which reveals a truncated chain."""
        if batch.rows:
            with suppress(OSError):  # the batch is committed in any case
                self._head.write(batch.rows[-1][:2])

    def _fail(self, reason: str) -> None:
        self._failing = True
        self._tell(self._reports.failed, reason)

    def _tell(self, what: Callable[..., None], *facts: Any) -> None:
        with suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(what, *facts)
