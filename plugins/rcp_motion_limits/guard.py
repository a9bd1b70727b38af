"""The guard of motion limits: refuses commands outside limits, and tracks commanded values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcp_kernel.access.acl import Rights
from rcp_kernel.features import Call, CommandObserver, Guard, Slot, StatusPart
from rcp_kernel.model import Kind
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_motion_limits.config import MotionLimitsConfig
from rcp_motion_limits.fence_watch import FenceWatch
from rcp_motion_limits.limits import MotionLimits

__all__ = ["MotionLimitGuard"]


class MotionLimitGuard(Guard, CommandObserver):
    """Holds commands to their limits."""

    slot = Slot.MOTION_LIMIT

    def __init__(self, limits: MotionLimits, fences: FenceWatch) -> None:
        self._limits = limits
        self._fences = fences

    def configure(self, config: MotionLimitsConfig) -> None:
        """Apply the limits of a configuration from now on."""
        self.active = bool(config.envelopes)
        self._limits.configure(config)

    def admit(self, call: Call) -> None:
        """Refuse a value outside the limits.

        :raises OutOfRange, ModeForbids, PreconditionFailed: as `MotionLimit.check`.
        """
        bound = self._limits.of(call.entry.path)
        if bound is not None:
            bound.check(call.session, call.value)

    def confirm(self, call: Call) -> None:
        """Check again just before the command is executed."""
        self.admit(call)

    def foresee(self, session: Session, entry: Entry, value: Any) -> None:
        """Refuse a value that could not be sent at any later time either.

        :raises OutOfRange: as `MotionLimit.check_value`.
        """
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.check_value(session, value)

    def dry_run(self, call: Call) -> Mapping[str, Any]:
        """Return the limits that applied, for a dry run."""
        return {"envelopes": self._limits.applied(call.session, call.entry) or None}

    def status(self, rights: Rights | None) -> StatusPart:
        """Report the paths that accept no commands because a limit does not fit them."""
        faults = self._limits.faults(rights)
        return StatusPart({"envelopes": faults}, degraded=bool(faults))

    # -- command events --------------------------------------------------------------------------

    def sent(self, call: Call) -> None:
        """Record that a value is being sent to the robot."""
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
        self._fences.moving(bound)

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Record that the robot accepted a value, as `actual`."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.settle(value, actual)

    def refused(self, entry: Entry, value: Any) -> None:
        """Record that the robot rejected a value and continues as before."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.withdraw(value)

    def stopping(self, entry: Entry, safe: Any) -> None:
        """Record that a safe value is being sent."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.attempt(safe)

    def rested(self, entry: Entry, safe: Any) -> None:
        """Record that the safe value is in force, or that the whole robot is at rest."""
        bound = self._limits.of(entry.path)
        if bound is not None:
            bound.force.rest(safe)
            self._limits.drivers.pop(entry.path, None)
