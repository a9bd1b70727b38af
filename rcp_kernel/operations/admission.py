"""What a write or an execute must pass: once when it comes in, and again at the moment it acts.

Between the two a command may wait in a queue, and the world may change meanwhile. A dry run
passes the first and ends there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rcp_kernel.clients.session import Session
from rcp_kernel.model import Operation
from rcp_kernel.motion.safety import check_age, check_motion
from rcp_kernel.registry import Entry
from rcp_kernel.spi import Backend
from rcp_kernel.wire import Request

if TYPE_CHECKING:
    from rcp_kernel.gateway import Gateway

__all__ = ["Admission"]


class Admission:
    """The checks, in the order in which a client should learn of them."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self.check_thaw: Callable[[Entry], None] = lambda _entry: None
        """Refuse what may have waited while the event loop stood still and its robot was stopped."""

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
            self._gateway.check_open()
            return
        check_motion(entry, entry.unit.latch)
        self.check_thaw(entry)
        self._gateway.leases.check(session, entry)
        self._gateway.check_open()
        self._gateway.audit_writer.check()
        if entry.owner.backend is None:
            raise entry.owner.unavailable()
        self._gateway.envelopes.check(session, entry, value)

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
        self._gateway.check(session, entry, called or Operation.WRITE)
        check_age(entry, timestamp)
        if not entry.is_hold:
            check_motion(entry, entry.unit.latch)
            self._gateway.leases.check(session, entry)
        backend = entry.owner.backend
        if backend is None:
            raise entry.owner.unavailable()
        if entry.is_hold:
            return backend
        self._gateway.envelopes.send(session, entry, value)
        return backend
