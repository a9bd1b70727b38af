"""What survives a restart: command history in SQLite, written by a thread of its own.

The event loop only appends to a queue; the thread writes what has gathered in one transaction.
"""

from __future__ import annotations

import queue
import sqlite3
import threading
from pathlib import Path
from typing import Any

import msgspec
import structlog

from rcp_kernel.clock import now
from rcp_kernel.commands import Command, Record
from rcp_kernel.errors import ConfigError, InternalError
from rcp_kernel.values import Encoding, dump, to_plain
from rcp_kernel.wire import NO_BODY, error_body

__all__ = ["Store"]

log = structlog.get_logger("rcp.store")
_SCHEMA = """
CREATE TABLE IF NOT EXISTS commands (
    id TEXT PRIMARY KEY, created INTEGER NOT NULL, final INTEGER NOT NULL, record BLOB NOT NULL
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS commands_created ON commands (created);
"""
_KEPT = 10_000  # commands
_BATCH = 500


class Store:
    """Command history on disk; a `commands.Keeper`."""

    def __init__(self, path: Path) -> None:
        """Open or create the database.

        :raises ConfigError: it cannot be opened.
        """
        self._path = path
        self._queue: queue.SimpleQueue[tuple[str, int, int, bytes] | None] = queue.SimpleQueue()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._connect().close()
        except (OSError, sqlite3.Error) as error:
            raise ConfigError(f"[store] path = '{path}' cannot be opened: {error}") from None
        self._thread = threading.Thread(target=self._write, name="rcp-store", daemon=True)
        self._thread.start()

    def _connect(self) -> sqlite3.Connection:
        base = sqlite3.connect(self._path)
        base.execute("PRAGMA journal_mode=WAL")
        base.execute("PRAGMA synchronous=NORMAL")
        base.executescript(_SCHEMA)
        return base

    def save(self, command: Command) -> None:
        """Note the command's present state; returns at once."""
        try:
            data = _encoded(command)
        except Exception:  # the command goes on, whether it can be written down or not
            log.exception("store_failed", command=command.id, path=command.path)
            return
        self._queue.put((command.id, command.created, int(command.final), data))

    def load(self) -> list[Command]:
        """Return the commands of earlier runs, oldest first; those cut off are `failed` now."""
        base = self._connect()
        try:
            rows = base.execute(
                "SELECT record FROM commands ORDER BY created DESC LIMIT 1000"
            ).fetchall()
        finally:
            base.close()
        found = [command for row in reversed(rows) if (command := _read(row[0])) is not None]
        for command in found:
            if not command.final:
                _cut_off(command)
                self.save(command)
        return found

    def _write(self) -> None:
        base = self._connect()
        try:
            while (first := self._queue.get()) is not None:
                rows = [first]
                while len(rows) < _BATCH and not self._queue.empty():
                    row = self._queue.get()
                    if row is None:
                        self._queue.put(None)
                        break
                    rows.append(row)
                self._save(base, rows)
        finally:
            base.close()

    def _save(self, base: sqlite3.Connection, rows: list[tuple[str, int, int, bytes]]) -> None:
        try:
            with base:
                base.executemany("INSERT OR REPLACE INTO commands VALUES (?, ?, ?, ?)", rows)
                base.execute(
                    "DELETE FROM commands WHERE final = 1 AND created < (SELECT created FROM "
                    "commands ORDER BY created DESC LIMIT 1 OFFSET ?)",
                    (_KEPT,),
                )
        except sqlite3.Error as error:
            log.error("store_failed", path=str(self._path), error=str(error), lost=len(rows))

    def close(self) -> None:
        """Write what is queued, then stop."""
        self._queue.put(None)
        self._thread.join(timeout=10)


def _encoded(command: Command) -> bytes:
    row = _as_row(command)
    try:
        return msgspec.msgpack.encode(row)
    except OverflowError:  # an integer past 64 bits: a text, as on the wire
        return msgspec.msgpack.encode(msgspec.json.decode(dump(row, Encoding.JSON)))


def _as_row(command: Command) -> dict[str, Any]:
    return {
        "id": command.id,
        "path": command.path,
        "principal": command.principal,
        "tenant": command.tenant,
        "request_id": command.request_id,
        "input": to_plain(command.input),
        "created": command.created,
        "finished": command.finished,
        "history": [
            {
                "status": r.status,
                "time": r.time,
                "progress": r.progress,
                "message": r.message,
                "error": r.error,
                **({} if r.body is NO_BODY else {"body": to_plain(r.body)}),
            }
            for r in command.history
        ],
    }


def _read(data: bytes) -> Command | None:
    """Return the command of a row; one that cannot be read is left out and told of."""
    try:
        return _from_row(msgspec.msgpack.decode(data))
    except (msgspec.DecodeError, TypeError, KeyError, AttributeError) as error:
        log.warning("store_row_unreadable", error=str(error))
        return None


def _from_row(row: dict[str, Any]) -> Command:
    steps = row.pop("history")
    command = Command(**row)
    for step in steps:
        step.setdefault("body", NO_BODY)
        command.history.append(Record(**step))
    return command


def _cut_off(command: Command) -> None:
    error = InternalError(
        "the gateway stopped while the command was running",
        path=command.path,
        remedy="Look at the state of the robot, then send the command again if it is still wanted.",
    )
    command.finished = now()
    command.history.append(
        Record("failed", command.finished, message=error.message, error=error_body(error))
    )
