"""Commands as rows of the store, and what becomes of those that a crash cut off."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import msgspec
import structlog
from msgspec import Raw
from msgspec.structs import asdict

from rcp_kernel.contract.identity import fingerprint
from rcp_kernel.contract.paths import EVERYTHING, is_system
from rcp_kernel.errors import InternalError, InvalidValue
from rcp_kernel.sessions.command import Command, Continuation, Record
from rcp_kernel.sessions.long_value import SCALARS, LongValue
from rcp_kernel.values import Encoding, to_plain
from rcp_kernel.wire import NO_BODY, error_body

__all__ = ["TABLE", "as_row", "cut_off", "from_rows", "row_key"]

log = structlog.get_logger("rcp.store")
TABLE = "commands"
_RANDOM = 8192  # bytes: as many keys as finished commands are kept
_keys: list[str] = []
"""Random keys of rows, each used once."""


def row_key() -> str:
    """Return the key of another row.

    Keys come in ascending order: the store writes whole pages, and commands of the same time are on
    few of them. They are random, as those of earlier runs may still be in the store, and are no ids of
    commands, whose order would tell each client how many commands others send.
    """
    if not _keys:
        random = os.urandom(_RANDOM)
        found = (random[place : place + 8].hex() for place in range(0, _RANDOM, 8))
        _keys.extend(sorted(found, reverse=True))
    return _keys.pop()


def as_row(command: Command) -> dict[str, Any]:
    """Return the present state of a command as it is kept."""
    return {
        "id": command.id,
        "path": command.path,
        "principal": command.principal,
        "proof": command.proof,
        "tenant": command.tenant,
        "request_id": command.request_id,
        "session": None if command.session is None else fingerprint(command.session),
        "touches": command.touches,
        "input": _written(command.input),
        "created": command.created,
        "finished": command.finished,
        "continuation": None if command.continuation is None else asdict(command.continuation),
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
    if isinstance(value, SCALARS):
        return value
    if isinstance(value, LongValue):
        try:
            return Raw(value.encoded(Encoding.MSGPACK))
        except InvalidValue:  # an integer of more than 64 bits: encoded by the store
            return to_plain(value.value)
    return to_plain(value)


def from_rows(rows: Mapping[str, dict[str, Any]]) -> list[Command]:
    """Return the commands of earlier runs, oldest first."""
    commands = [found for key, row in rows.items() if (found := _read(key, row)) is not None]
    return sorted(commands, key=lambda command: command.created)


def _read(key: str, row: dict[str, Any]) -> Command | None:
    """Return the command of a row; an unreadable one is skipped and logged."""
    try:
        steps = row.pop("history")
        unknown = (EVERYTHING,) if is_system(row["path"]) else ()  # of a gateway before this one
        row["touches"] = tuple(row.get("touches", unknown))
        row["continuation"] = msgspec.convert(row.get("continuation"), Continuation | None)
        command = Command(**row, row=key)
        for step in steps:
            step.setdefault("body", NO_BODY)
            command.history.append(Record(**step))
    except (TypeError, KeyError, AttributeError, msgspec.ValidationError) as error:
        log.warning("store_row_unreadable", table=TABLE, error=str(error))
        return None
    return command


def cut_off(command: Command, moment: int) -> None:
    """End a command that was interrupted by the end of the gateway."""
    error = InternalError(
        "the gateway stopped while the command was running",
        path=command.path,
        remedy="Check the state of the robot, then send the command again if it is still needed.",
    )
    command.finished = moment
    command.history.append(
        Record("failed", command.finished, message=error.message, error=error_body(error))
    )
