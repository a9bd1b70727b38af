"""Command history as it is kept in the store, and what becomes of commands that a crash cut off."""

from __future__ import annotations

from typing import Any

import structlog
from msgspec import Raw

from rcp_kernel.clock import now
from rcp_kernel.errors import InternalError, InvalidValue
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.sessions.long_value import LongValue
from rcp_kernel.sessions.resume import hashed
from rcp_kernel.store.store import Store
from rcp_kernel.store.touches import EVERYTHING
from rcp_kernel.tree.entry import is_system
from rcp_kernel.values import Encoding, to_plain
from rcp_kernel.wire import NO_BODY, error_body

__all__ = ["History"]

log = structlog.get_logger("rcp.store")
_TABLE = "commands"


class History:
    """A `commands.Keeper` over the store."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self.cut_off: list[Command] = []
        """Those that the end of the earlier run cut off."""

    def save(self, command: Command) -> None:
        """Note the command's present state."""
        if not self._store.keeps:
            return
        try:
            row = _as_row(command)
        except Exception:  # the command goes on, whether it can be written down or not
            log.exception("store_failed", command=command.id, path=command.path)
            return
        self._store.put(_TABLE, command.id, row)

    def forget(self, command: Command) -> None:
        """Let a command go that is too old to be remembered."""
        self._store.put(_TABLE, command.id, None)

    def load(self) -> list[Command]:
        """Return the commands of earlier runs, oldest first; those cut off are `failed` now."""
        rows = self._store.load(_TABLE).values()
        found = [command for row in rows if (command := _read(row)) is not None]
        for command in found:
            if not command.final:
                _cut_off(command)
                self.save(command)
                self.cut_off.append(command)
        return sorted(found, key=lambda command: command.created)


def _as_row(command: Command) -> dict[str, Any]:
    return {
        "id": command.id,
        "path": command.path,
        "principal": command.principal,
        "proof": command.proof,
        "tenant": command.tenant,
        "request_id": command.request_id,
        "session": None if command.session is None else hashed(command.session),
        "touches": command.touches,
        "input": _written(command.input),
        "created": command.created,
        "finished": command.finished,
        "history": [
            {
                "status": r.status,
                "time": r.time,
                "progress": r.progress,
                "message": r.message,
                "error": r.error,
                **({} if r.body is NO_BODY else {"body": _written(r.body)}),
            }
            for r in command.history
        ],
    }


def _written(value: Any) -> Any:
    """Return a value as it is put into the row; a long one is written already."""
    if isinstance(value, LongValue):
        try:
            return Raw(value.encoded(Encoding.MSGPACK))
        except InvalidValue:  # an integer of more than 64 bits: the store finds a way
            return to_plain(value.value)
    return to_plain(value)


def _read(row: dict[str, Any]) -> Command | None:
    """Return the command of a row; one that cannot be read is left out and told of."""
    try:
        steps = row.pop("history")
        unknown = (EVERYTHING,) if is_system(row["path"]) else ()  # of a gateway before this one
        row["touches"] = tuple(row.get("touches", unknown))
        command = Command(**row)
        for step in steps:
            step.setdefault("body", NO_BODY)
            command.history.append(Record(**step))
    except (TypeError, KeyError, AttributeError) as error:
        log.warning("store_row_unreadable", table=_TABLE, error=str(error))
        return None
    return command


def _cut_off(command: Command) -> None:
    error = InternalError(
        "the gateway stopped while the command was running",
        path=command.path,
        remedy="Check the state of the robot, then send the command again if it is still needed.",
    )
    command.finished = now()
    command.history.append(
        Record("failed", command.finished, message=error.message, error=error_body(error))
    )
