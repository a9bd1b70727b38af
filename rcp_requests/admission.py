"""Whether a request may do what it asks for: rights to a path, then the state of its robot, then guards.

`Resolver` finds the resource that any request names, and checks the rights. `Admission` checks a write
or execute on arrival, and again just before it is executed: in between, a command may be queued and
the state may change. A dry run ends after the first checks.
"""

from __future__ import annotations

from collections.abc import Sequence

from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.errors import (
    AdapterUnavailable,
    BadRequest,
    Forbidden,
    RcpError,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.features import Call, Guard, Slot
from rcp_kernel.features.observer import CommandEvents
from rcp_kernel.model import Operation, operation_names, parse_path
from rcp_kernel.safety.motion_checks import check_age, check_hold, check_motion
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import Backend
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_requests.replies import ReplyGate

__all__ = ["Admission", "Resolver"]

_WHOLE = ("/tenant/", "/system/")
_EXECUTE, _WRITE = int(Operation.EXECUTE), int(Operation.WRITE)  # as in `Resolver.resolve`
_AGAIN = 0.5  # s after which to retry a path that may appear


class Resolver:
    """Finds what requests name."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry

    def resolve(
        self, session: Session, path: str | None, operation: Operation, *, anyway: bool = False
    ) -> Entry:
        """Find the entry of a path and make sure that the session may do `operation` with it.

        `anyway`: also if the condition of its rule does not hold now.

        :raises InvalidPath: it is not a path.
        :raises UnknownPath: there is no such resource, or it is hidden from the session.
        :raises Forbidden: the rights do not allow the operation.
        :raises UnsupportedOperation: the resource does not offer it.
        """
        if path is None:
            raise BadRequest("`path` is missing", remedy="Send `path` with the path of a resource.")
        # A hidden path must cost as much as a missing one: check the rights first.
        full = path if path.startswith(_WHOLE) else parse_path(path, session.tenant)
        rights = session.rights
        known = rights.masks.get(full)
        mask = known or rights.compute_mask(full)
        entry = self._registry.entries.get(full)
        if entry is None or not mask:
            parse_path(full, None)
            # By rights and place alone: a hidden path is answered like a missing one.
            if mask and self._registry.may_come(full):
                raise _not_yet(full)
            raise UnknownPath(f"no resource {full}", path=full)
        if not known:
            rights.remember(full, mask)
        # As integers: Python makes a new flag of each `&` of two, which costs more than all the rest.
        bits = int(operation)
        if not int(entry.operations) & bits:
            offered = operation_names(entry.operations)
            verb = operation_names(operation)[0]
            raise UnsupportedOperation(
                f"{entry.path} does not offer `{verb}`; it offers {', '.join(offered)}",
                path=entry.path,
                details={"allowed": offered},
            )
        if not mask & bits and not (anyway and rights.depends(entry, operation)):
            self.check(session, entry, operation)
        return entry

    def check(self, session: Session, entry: Entry, operation: Operation) -> None:
        """Refuse an operation that the rules do not allow as things are.

        :raises Forbidden: they do not.
        """
        rights = session.rights
        if rights.masks.get(entry.path, 0) & int(operation) or rights.permits(entry, operation):
            return
        verb = operation_names(operation)[0]
        text = f"{session.principal.name} may not {verb} {entry.path}"
        if not rights.depends(entry, operation):
            raise Forbidden(text, path=entry.path)
        blocking = rights.blocking_condition(entry, operation)
        if blocking is None or not rights.shows(blocking, entry):
            raise Forbidden(f"{text} at the moment", path=entry.path, remedy="Try again later.")
        raise Forbidden(
            f"{text} at the moment: the rule requires `{blocking.text}`",
            path=entry.path,
            remedy="Wait until the condition holds, or ask the operator to change the rule.",
            details={"condition": blocking.text},
        )


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
        self.other_guards: tuple[Guard, ...] = ()
        """The active guards but those of `control`, in order."""
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
        self.other_guards = tuple(guard for guard in active if guard.slot is not Slot.LEASE)
        self._early = tuple(g for g in self.other_guards if g.slot is Slot.MOTION_LIMIT)
        self._late = self.other_guards[len(self._early) :]

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
        if entry.barred and (unit.all_latches or unit.whole.retired is not None):
            check_motion(entry)
        if entry.tenant is not None:
            for guard in self.control:  # `_admit_all` inlined: nearly every command is checked here
                if not guard.idle:
                    try:
                        guard.admit(call)
                    except Exception as error:
                        raise _refusal(guard, call, error) from None
        if entry.barred and (unit.holds or unit.whole.holds):
            check_hold(entry, call.value)
        if self._shutdown.begun:
            self._shutdown.check()
        for demand in self._replies.demands:
            demand.check()
        if unit.usable_backend is None:
            raise unit.unavailable()
        if self._early and _concerns_guards(call):
            _admit_all(self._early, call)

    def admit_late(self, call: Call) -> None:
        """Call the last guards, when nothing else refuses the call.

        :raises RcpError: one refuses.
        """
        if self._late and _concerns_guards(call):
            _admit_all(self._late, call)

    def admit_late_all(self, calls: Sequence[Call]) -> None:
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
        executes = request.type == "execute"
        called = _EXECUTE if executes else _WRITE
        if not call.session.rights.masks.get(entry.path, 0) & called:
            self._resolver.check(call.session, entry, Operation(called))
        if request.timestamp is not None:
            check_age(entry, request.timestamp)
        if not entry.is_hold:
            if entry.barred:
                if unit.all_latches or unit.whole.retired is not None:
                    check_motion(entry)
                if unit.holds or unit.whole.holds:
                    check_hold(entry, call.value)
            if entry.tenant is not None:
                for guard in self.control:  # `_confirm_all` inlined
                    if not guard.idle:
                        try:
                            guard.confirm(call)
                        except Exception as error:
                            raise _refusal(guard, call, error) from None
        backend = unit.usable_backend
        if backend is None:
            raise unit.unavailable()
        if entry.is_hold:
            return backend
        if self.other_guards and _concerns_guards(call):
            _confirm_all(self.other_guards, call)
        if not executes or self._events.of_executes:
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
        if not guard.idle:
            try:
                guard.admit(call)
            except Exception as error:
                raise _refusal(guard, call, error) from None


def _confirm_all(guards: Sequence[Guard], call: Call) -> None:
    for guard in guards:
        if not guard.idle:
            try:
                guard.confirm(call)
            except Exception as error:
                raise _refusal(guard, call, error) from None


def _refusal(guard: Guard, call: Call, error: Exception) -> RcpError:
    """Return a guard's refusal, also for a guard that failed; its exception is logged then."""
    return to_internal_error(error, guard=type(guard).__module__, path=call.entry.path)


def _not_yet(path: str) -> RcpError:
    return AdapterUnavailable(
        f"no resource {path} yet: a robot that may have it is not connected",
        path=path,
        remedy="Send it again after `retry_after` seconds; `status` shows each backend.",
        retry_after=_AGAIN,
    )
