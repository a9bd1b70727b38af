"""The checks that a write or execute must pass: on arrival, and again just before it is executed.

In between, a command may be queued and the state may change. A dry run ends after the first checks.
"""

from __future__ import annotations

from collections.abc import Sequence

from rcp_kernel.contract.pending import to_internal_error
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.errors import RcpError
from rcp_kernel.features import Call, Guard, Slot
from rcp_kernel.features.commands import CommandEvents
from rcp_kernel.model import Operation
from rcp_kernel.requests.replies import ReplyGate
from rcp_kernel.safety.safety import check_age, check_hold, check_motion
from rcp_kernel.sessions.resolver import Resolver
from rcp_kernel.spi import Backend

__all__ = ["Admission"]


class Admission:
    """The checks, in the order in which a client should learn of them."""

    def __init__(
        self,
        resolver: Resolver,
        events: CommandEvents,
        replies: ReplyGate,
        shutdown: Shutdown,
        guards: Sequence[Guard],
    ) -> None:
        self._resolver = resolver
        self._events = events
        self._replies = replies
        self._shutdown = shutdown
        self._every = sorted(guards, key=lambda guard: guard.slot)
        self.active: tuple[Guard, ...] = ()
        """The active guards, in order."""
        self.control: tuple[Guard, ...] = ()
        """The active guards that decide who has control: they come first, and also check safe
        values."""
        self._early: tuple[Guard, ...] = ()
        """The active guards that are called before the quota."""
        self._late: tuple[Guard, ...] = ()
        self.configure()

    def configure(self) -> None:
        """Find out which guards the configuration in force needs."""
        active = [guard for guard in self._every if guard.active]
        self.control = tuple(guard for guard in active if guard.slot is Slot.LEASE)
        self.active = tuple(guard for guard in active if guard.slot is not Slot.LEASE)
        self._early = tuple(g for g in self.active if g.slot is Slot.MOTION_LIMIT)
        self._late = self.active[len(self._early) :]

    def admit(self, call: Call) -> None:
        """Refuse a call that is not allowed now, before quotas and the last guards.

        :raises StaleCommand: the request is older than its path allows.
        :raises EstopActive: the path moves something, and its robot is stopped.
        :raises AlreadyRunning: the path moves something, and its robot is being brought to rest.
        :raises AdapterUnavailable: the gateway is closing, or there is no robot.
        :raises QueueFull: a feature could not store the record that its reply confirms.
        :raises RcpError: refused by a guard for control or motion.
        """
        entry, timestamp = call.entry, call.request.timestamp
        if timestamp is not None:
            check_age(entry, timestamp)
        if entry.is_hold:  # everyone with the right to execute it may bring a robot to rest
            self._shutdown.check()
            return
        unit = entry.unit
        if entry.barred and (unit.latched or unit.whole.retired is not None):
            check_motion(entry)
        if entry.tenant is not None:
            for guard in self.control:  # as `_admit_all`, but for nearly every command
                if not getattr(guard, "idle", False):
                    _admit(guard, call)
        if entry.barred and (unit.holds or unit.whole.holds):
            check_hold(entry, call.value)
        if self._shutdown.begun:
            self._shutdown.check()
        for demand in self._replies.demands:
            demand.check()
        if unit.link is None:
            raise unit.unavailable()
        if self._early and _concerns_guards(call):
            _admit_all(self._early, call)

    def ask(self, call: Call) -> None:
        """Call the last guards, when nothing else refuses the call.

        :raises RcpError: one refuses.
        """
        if self._late and _concerns_guards(call):
            _admit_all(self._late, call)

    def ask_all(self, calls: Sequence[Call]) -> None:
        """Call the last guards for several calls: each guard for all of them before the next.

        The last one uses an approval up, after which nothing may refuse.

        :raises RcpError: one refuses.
        """
        for guard in self._late:
            for call in calls:
                if _concerns_guards(call):
                    _admit_all((guard,), call)

    def check_control(self, call: Call) -> None:
        """Refuse a call that must no longer reach its robot, even to bring something to rest.

        :raises EstopActive: the path moves something, and its robot is stopped.
        :raises RcpError: refused by a guard for control.
        """
        check_motion(call.entry)
        if self.control and call.entry.tenant is not None:
            _confirm_all(self.control, call)

    def confirm(self, call: Call) -> Backend:
        """Check a call again with the session's current rights, and return its backend.

        :raises StaleCommand: it has become too old while it was queued.
        :raises Forbidden: the rights were revoked, or their condition does not hold.
        :raises EstopActive, AlreadyRunning: as above.
        :raises AdapterUnavailable: there is no robot any more.
        :raises RcpError: a guard refuses.
        """
        entry, request = call.entry, call.request
        unit = entry.unit
        called = Operation.EXECUTE if request.type == "execute" else Operation.WRITE
        if not call.session.rights.masks.get(entry.path, 0) & called.value:
            self._resolver.check(call.session, entry, called)
        if request.timestamp is not None:
            check_age(entry, request.timestamp)
        if not entry.is_hold:
            if entry.barred:
                if unit.latched or unit.whole.retired is not None:
                    check_motion(entry)
                if unit.holds or unit.whole.holds:
                    check_hold(entry, call.value)
            if entry.tenant is not None:
                for guard in self.control:
                    if not getattr(guard, "idle", False):
                        _confirm(guard, call)
        backend = unit.link
        if backend is None:
            raise unit.unavailable()
        if entry.is_hold:
            return backend
        if self.active and _concerns_guards(call):
            _confirm_all(self.active, call)
        self._events.sent(call)
        return backend


def _concerns_guards(call: Call) -> bool:
    """Return whether guards other than those for control are called.

    None may prevent bringing something to rest. An action of the gateway itself passes none: the
    requests that it sends do.
    """
    return call.entry.tenant is not None and not call.rests


def _admit_all(guards: Sequence[Guard], call: Call) -> None:
    for guard in guards:
        if not getattr(guard, "idle", False):  # which few guards have
            _admit(guard, call)


def _confirm_all(guards: Sequence[Guard], call: Call) -> None:
    for guard in guards:
        if not getattr(guard, "idle", False):
            _confirm(guard, call)


def _admit(guard: Guard, call: Call) -> None:
    try:
        guard.admit(call)
    except RcpError:
        raise
    except Exception as error:
        raise _broken(guard, call, error) from None


def _confirm(guard: Guard, call: Call) -> None:
    try:
        guard.confirm(call)
    except RcpError:
        raise
    except Exception as error:
        raise _broken(guard, call, error) from None


def _broken(guard: Guard, call: Call, error: Exception) -> RcpError:
    """Return the refusal for a guard that failed; its exception is logged."""
    return to_internal_error(error, guard=type(guard).__module__, path=call.entry.path)
