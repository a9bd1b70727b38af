"""What a write or an execute must pass: once when it comes in, and again at the moment it acts.

Between the two a command may wait in a queue, and the world may change meanwhile. A dry run
passes the first and ends there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_kernel.access.resolver import Resolver
from rcp_kernel.clients.session import Session
from rcp_kernel.model import Operation
from rcp_kernel.motion.leases import Leases
from rcp_kernel.motion.motion_limits import MotionLimits
from rcp_kernel.motion.safety import check_age, check_motion
from rcp_kernel.record.audit_writer import AuditWriter
from rcp_kernel.registry import Entry
from rcp_kernel.shutdown import Shutdown
from rcp_kernel.spi import Backend
from rcp_kernel.wire import Request

__all__ = ["Admission"]


class Admission:
    """The checks, in the order in which a client should learn of them."""

    def __init__(
        self,
        resolver: Resolver,
        leases: Leases,
        motion_limits: MotionLimits,
        audit_writer: AuditWriter,
        shutdown: Shutdown,
        check_thaw: Callable[[Entry], None],
    ) -> None:
        self._resolver = resolver
        self._leases = leases
        self._motion_limits = motion_limits
        self._audit_writer = audit_writer
        self._shutdown = shutdown
        self._check_thaw = check_thaw
        """Refuses what may have waited while the event loop stood still and its robot was stopped."""

    def admit(self, session: Session, request: Request, entry: Entry, value: Any) -> None:
        """Refuse what may not be done now.

        :raises StaleCommand: the request is older than its path allows, or came in a freeze.
        :raises EstopActive: the path moves something, and its robot is stopped.
        :raises LeaseHeld, LeaseLost, LeaseRequired: somebody else has control, or nobody.
        :raises AdapterUnavailable: the gateway is closing, or there is no robot.
        :raises QueueFull: it could not be put on record.
        :raises OutOfRange, ModeForbids, PreconditionFailed: an envelope does not hold.
        """
        check_age(entry, request.timestamp)
        if entry.is_hold:  # bringing a robot to rest is open to whoever may execute it
            self._shutdown.check()
            return
        check_motion(entry, entry.unit.latch)
        self._check_thaw(entry)
        self._leases.check(session, entry)
        self._shutdown.check()
        self._audit_writer.check()
        if entry.owner.backend is None:
            raise entry.owner.unavailable()
        self._motion_limits.check(session, entry, value)

    def confirm(
        self, session: Session, entry: Entry, value: Any, timestamp: str | float | None
    ) -> Backend:
        """Return the robot that takes it, or refuse what must not reach it any more.

        `session` is whose request it is, with the rights it has by now; `timestamp` is the
        request's.

        :raises StaleCommand: it has become too old while it waited.
        :raises Forbidden: its rights are not there any more, or their condition does not hold.
        :raises EstopActive, LeaseHeld, LeaseLost, LeaseRequired: as above.
        :raises AdapterUnavailable: there is no robot any more.
        :raises OutOfRange, ModeForbids, PreconditionFailed: as above.
        """
        called = entry.operations & Operation.EXECUTE
        self._resolver.check(session, entry, called or Operation.WRITE)
        check_age(entry, timestamp)
        if not entry.is_hold:
            check_motion(entry, entry.unit.latch)
            self._leases.check(session, entry)
        backend = entry.owner.backend
        if backend is None:
            raise entry.owner.unavailable()
        if entry.is_hold:
            return backend
        self._motion_limits.send(session, entry, value)
        return backend
