"""Guards: what a feature may refuse, and when it is asked.

The kernel asks in one order, whatever is configured: rights, age, e-stop, the guards in the slots
`LEASE` and `MOTION_LIMIT`, accounts, then the other guards by their slot. It never asks a guard about an
e-stop or a hold; about the safe value of an actuator it asks those in the slot `LEASE` alone.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Protocol

import msgspec

from rcp_kernel.safety.safety import is_safe
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request

__all__ = ["Call", "Guard", "Slot"]


class Slot(IntEnum):
    """Where in the admission a guard is asked; within one slot by the feature's name."""

    LEASE = 10
    """Who has control: asked also about the safe value of an actuator, for that is a command that
    takes over from another. Holds and e-stops pass."""
    MOTION_LIMIT = 20
    """What a value, or the state of the robot, must be like; before a quota is used."""
    POLICY = 40
    """A rule of the site: maintenance, opening hours."""
    APPROVAL = 50
    """Last, because it uses something up that others gave: nothing else refuses any more."""


class Call(msgspec.Struct, frozen=True):
    """A write or an execute that would act on a robot, as guards see it."""

    session: Session
    """Whose it is; its `principal` and `rights` are those of now."""
    request: Request
    """The envelope. Its body is decoded: see `value`."""
    entry: Entry
    """What it commands: `entry.path`, `entry.resource`, `entry.moves`, `entry.tenant`."""
    value: Any
    """What would be sent, of the resource's type."""

    @property
    def rests(self) -> bool:
        """Whether it brings something to rest, which only the slot `LEASE` may refuse."""
        return self.entry.is_hold or is_safe(self.entry, self.value)


class Guard(Protocol):
    """Refuses calls by raising an `RcpError`; any other exception refuses as `internal`.

    Both methods run on the event loop for each write and execute: they look things up, and neither
    block nor await.
    """

    @property
    def slot(self) -> Slot:
        """Where it stands in the admission."""
        ...

    @property
    def active(self) -> bool:
        """Whether its configuration lets it refuse anything; asked at the start and at a reload.

        One that is not is left out of the admission and costs nothing.
        """
        ...

    def admit(self, call: Call) -> None:
        """Refuse what may not be done now. Dry runs (`call.request.dry_run`) change nothing."""
        ...

    def confirm(self, call: Call) -> None:
        """Refuse what may not be done any more, at the moment it acts: it may have waited."""
        ...
