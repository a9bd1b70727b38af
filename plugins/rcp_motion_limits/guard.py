"""The guard: refuses what an envelope does not let through, and notes what robots were told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcp_kernel.access.acl import Rights
from rcp_kernel.features import Call, Slot, StatusPart
from rcp_kernel.model import Kind
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_motion_limits.limits import MotionLimits

__all__ = ["MotionLimitGuard"]


class MotionLimitGuard:
    """Holds commands to their envelopes."""

    slot = Slot.MOTION_LIMIT

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits

    @property
    def active(self) -> bool:
        """Whether there is any envelope."""
        return self._limits.active

    def admit(self, call: Call) -> None:
        """Refuse a value outside an envelope.

        :raises OutOfRange, ModeForbids, PreconditionFailed: as `MotionLimit.check` does.
        """
        bound = self._limits.of(call.entry.path)
        if bound is not None:
            bound.check(call.session, call.value)

    def confirm(self, call: Call) -> None:
        """Refuse it by what holds when it acts."""
        self.admit(call)

    def foresee(self, session: Session, entry: Entry, value: Any) -> None:
        """Refuse a value that could not be sent later either.

        :raises OutOfRange: as `MotionLimit.check_value` does.
        """
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.check_value(session, value)

    def dry_run(self, call: Call) -> Mapping[str, Any]:
        """Tell a dry run which envelopes it stayed in."""
        return {"envelopes": self._limits.applied(call.session, call.entry) or None}

    def status(self, rights: Rights | None) -> StatusPart:
        """Tell which paths accept nothing because an envelope does not fit them."""
        faults = self._limits.faults(rights)
        return StatusPart({"envelopes": faults}, degraded=bool(faults))

    # -- what becomes of commands --------------------------------------------------------------

    def sent(self, call: Call) -> None:
        """Note that a value goes to the robot right now."""
        bound, value = self._limits.of(call.entry.path), call.value
        if bound is None:
            return
        bound.force.attempt(value)
        if call.entry.kind in (Kind.ACTION, Kind.SERVICE):
            bound.force.settle(value, value)
        elif bound.safe is None or value == bound.safe:
            self._limits.drivers.pop(call.entry.path, None)
        else:
            self._limits.drivers[call.entry.path] = call.session

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Note that the robot took what was sent, as `actual`."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.settle(value, actual)

    def refused(self, entry: Entry, value: Any) -> None:
        """Note that the robot did not take what was sent and goes on as before."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.withdraw(value)

    def stopping(self, entry: Entry, safe: Any) -> None:
        """Note that a safe value is on its way."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.attempt(safe)

    def rested(self, entry: Entry, safe: Any) -> None:
        """Note that a safe value is in force, or the robot is brought to rest as a whole."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.rest(safe)
            self._limits.drivers.pop(entry.path, None)
