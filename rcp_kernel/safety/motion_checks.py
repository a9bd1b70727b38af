"""What a request that moves something must pass: no e-stop, no hold, not stale."""

from __future__ import annotations

from typing import Any

from rcp_kernel.clock import iso, parse_time
from rcp_kernel.errors import AlreadyRunning, EstopActive, StaleCommand
from rcp_kernel.safety.safe_value import is_safe
from rcp_kernel.tree.entry import Entry

__all__ = ["check_age", "check_hold", "check_motion"]


def check_motion(entry: Entry) -> None:
    """Refuse motion under a latched e-stop.

    :raises EstopActive: the path moves something, and its robot is stopped.
    """
    latch = entry.unit.latch if entry.barred else None
    if latch is not None:
        raise EstopActive(
            f"{latch.by} has latched an e-stop" + (f": {latch.reason}" if latch.reason else ""),
            path=entry.path,
            details=latch.plain(),
        )


def check_hold(entry: Entry, value: Any) -> None:
    """Refuse motion of a robot that is being brought to rest, which would override the hold.

    :raises AlreadyRunning: a hold has not ended yet.
    """
    if entry.unit.is_held and entry.barred and not is_safe(entry, value):
        raise AlreadyRunning(
            f"{entry.unit.name} is being brought to rest",
            path=entry.path,
            remedy="Send the command again when the robot is at rest.",
        )


def check_age(entry: Entry, timestamp: str | float) -> None:
    """Refuse a command that is older, or further in the future, than its path allows.

    A command that moves something must also not be older than the last reset of an e-stop.

    :raises StaleCommand: it is.
    :raises BadRequest: its timestamp is not a time.
    """
    sent = parse_time(timestamp)
    if sent < entry.unit.released and entry.barred:
        raise StaleCommand(
            f"the command was sent before the e-stop on {entry.unit.name} was reset",
            path=entry.path,
            remedy="Check the robot, then send a new command.",
            details={"reset": iso(entry.unit.released)},
        )
    limit = entry.resource.max_age
    if limit is None:
        return
    age = (entry.clock.now() - sent) / 1e9
    if abs(age) > limit:
        raise StaleCommand(
            f"the command is {age:.3f} s old; the limit of {entry.path} is {limit:g} s",
            path=entry.path,
            details={"age": age, "max_age": limit},
        )
