"""What came of a command or write: whether the robot acted, and the status that says so.

An answer never says `rejected` once something has begun to move.
"""

from __future__ import annotations

import asyncio
from typing import Any

from rcp_kernel.contract.internal_errors import attribute_error
from rcp_kernel.errors import (
    Cancelled,
    DeadlineExceeded,
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
    RcpError,
    Refused,
)
from rcp_kernel.safety.loss import tell_loss
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.wire import NO_BODY, Status, error_body

__all__ = ["failed_step", "is_unchanged", "outcome_of"]


def outcome_of(command: Command, task: asyncio.Task[Any]) -> Any:
    """Return the outcome of a command's task: its result, or the error sent to the client."""
    error = None if task.cancelled() else task.exception()
    fenced = isinstance(error, EstopActive) and command.cancelling is not None
    if task.cancelled() or fenced:  # what it did last was fenced off by the stop that ended it
        reason = command.cancelling or "the backend cancelled it"
        return Cancelled(f"{command.path} was cancelled: {reason}", path=command.path)
    if error is None:
        return task.result()
    origin = None if command.entry is None else command.entry.owner.name
    return attribute_error(
        error, origin, command.path, sent=True, trace=command.trace, command=command.id
    )


def _has_begun(command: Command) -> bool:
    """Return whether the robot is known to have acted on a command."""
    return any(step.status == "in_progress" for step in command.history)


def is_unchanged(error: BaseException) -> bool:
    """Return whether an error means that the state of the robot is unchanged.

    One that has the status `failed` is a refusal by its code only: its robot may have acted.
    """
    if isinstance(error, Refused):
        return error.status != "failed"
    return isinstance(error, DeviceRejected)


def _status_of(command: Command, error: RcpError) -> Status:
    """A refusal by the robot before anything was seen to move is `rejected`, later it is `failed`."""
    if isinstance(error, Cancelled):
        return "cancelled"
    # What a robot's own gateway calls `failed` had begun there, regardless of what was reported here.
    refused = is_unchanged(error) and vars(error).get("status") != "failed"
    # A cancel that fails is no refusal: the robot may have begun, and may go on.
    return (
        "rejected"
        if refused and not _has_begun(command) and command.cancelling is None
        else "failed"
    )


def failed_step(command: Command, error: RcpError, moment: int) -> Record:
    """Return the final step of a command that ends with an error."""
    entry = command.entry
    error.path = error.path or command.path
    if entry is not None:
        error.origin = error.origin or entry.owner.name
        if command.task is not None:
            tell_loss(entry, error, command.began)
    body = NO_BODY if command.work is None else command.work.report(over=True)
    facts = error_body(error)
    if _has_effect(command, error):
        facts["retryable"] = False  # a repeat would act on top of what is done already
    status = _status_of(command, error)
    return Record(status, moment, body, message=error.message, error=facts)


def _has_effect(command: Command, error: RcpError) -> bool:
    """Return whether the robot has acted on a command that failed, or may have."""
    entry = command.entry
    if entry is not None and entry.is_hold:  # a repeat has the same effect
        return False
    unknown = command.sent and isinstance(error, (DeadlineExceeded, DeviceTimeout))
    return _has_begun(command) or (unknown and entry is not None and entry.moves)
