"""Guards: checks by which a feature can refuse commands.

The kernel checks in a fixed order: rights, age, e-stop, guards in the slots `LEASE` and
`MOTION_LIMIT`, quotas, then the other guards by slot. E-stops and holds are never checked by a
guard, and the safe value of an actuator only by those in the slot `LEASE`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import IntEnum
from typing import Any

import msgspec

from rcp_kernel.safety.safe_value import is_safe
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request

__all__ = ["Call", "Guard", "Slot"]


class Slot(IntEnum):
    """The position of a guard in admission; within a slot, guards are ordered by feature name."""

    LEASE = 10
    """Control: also checks the safe value of an actuator, because that command takes control from
    another client. Holds and e-stops pass."""
    MOTION_LIMIT = 20
    """Requirements on the value or the robot's state; before a quota is charged."""
    POLICY = 40
    """Site rules such as maintenance or opening hours."""
    APPROVAL = 50
    """Last, because it uses an approval up: nothing can refuse the command after it."""


class Call(msgspec.Struct, frozen=True):
    """A write or execute on a robot, as guards see it."""

    session: Session
    """The sender; `principal` and `rights` are current."""
    request: Request
    """The envelope. Its body is decoded in `value`."""
    entry: Entry
    """The target: `entry.path`, `entry.resource`, `entry.moves`, `entry.tenant`."""
    value: Any
    """The value to be sent, of the resource's type."""
    together: tuple[tuple[Entry, Any], ...] = ()
    """All targets and values of a write of several paths as one, this one among them.

    Each of them is a call of its own; guards are called for all of them before the robot is."""

    @property
    def rests(self) -> bool:
        """Whether it brings something to rest, which only the slot `LEASE` may refuse."""
        return self.entry.is_hold or is_safe(self.entry, self.value)


class Guard(ABC):
    """Refuses calls by raising an `RcpError`; any other exception refuses as `internal`.

    Both methods run on the event loop for each write and execute, and must neither block nor await.
    """

    slot: Slot
    """The position in admission."""

    idle: bool = False
    """Whether both methods would do nothing now, so that neither is called. It is read for each call,
    and therefore an attribute."""

    active: bool = True
    """Whether the configuration lets it refuse anything: an inactive guard is not called, nor the
    observer of its feature. It is read once all features are made, and again after their `reconfigure`."""

    @abstractmethod
    def admit(self, call: Call) -> None:
        """Refuse a call now. For dry runs (`call.request.dry_run`) it must not change anything."""

    @abstractmethod
    def confirm(self, call: Call) -> None:
        """Check again just before the call is executed: it may have waited."""
