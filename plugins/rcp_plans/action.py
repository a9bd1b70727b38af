"""`/system/plans`: a plan that passes its check becomes a command."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence

from rcp_kernel.clock import iso
from rcp_kernel.errors import PayloadTooLarge, QueueFull
from rcp_kernel.features import ActionHost
from rcp_kernel.features.approval import APPROVALS, NoApprovals
from rcp_kernel.features.control import CONTROL, NoControl
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import NO_BODY, Request
from rcp_plans.checks import PlanChecker
from rcp_plans.config import PlansConfig, PlansTable
from rcp_plans.model import Plan, PlanState
from rcp_plans.pace import Allowance
from rcp_plans.run import PlanRun
from rcp_plans.stops import only_stops
from rcp_protocol.plain import is_map

__all__ = ["Plans"]


class Plans:
    """The `execute` action of `/system/plans`."""

    def __init__(self, config: PlansConfig) -> None:
        self._config = config
        self._allowance = Allowance()

    def reconfigure(self, table: PlansTable) -> None:
        """Apply a new configuration; running plans continue."""
        self._config = table.plans

    def admit(self, session: Session, running: Sequence[Command]) -> None:
        """Refuse a plan beyond the limit.

        :raises QueueFull: the tenant already runs as many plans as allowed.
        """
        limit = self._config.running
        if sum(1 for command in running if command.tenant == session.tenant) >= limit:
            raise QueueFull(
                f"this tenant already has {limit} plans running",
                remedy="Wait until one ends, or cancel one.",
                details={"limit": limit},
            )

    def prepare(
        self, session: Session, request: Request, entry: Entry, host: ActionHost
    ) -> Generator[None, None, PlanRun]:
        """Check a whole plan, in steps.

        :raises PayloadTooLarge: the plan is too long.
        :raises RcpError: the plan is invalid; see `PlanChecker.check`.
        """
        size, limit = len(bytes(request.body)), self._config.size
        if size > limit:
            raise PayloadTooLarge(
                f"the plan has {size} bytes; the limit is {limit}", details={"limit": limit}
            )
        plan: Plan = request.decode_body(entry.input_type, f"input of {entry.label}")
        yield
        approvals = host.service(APPROVALS) or NoApprovals()
        control = host.service(CONTROL) or NoControl()
        checker = PlanChecker(host, control, approvals, self._config, self._allowance)
        checked = yield from checker.check(session, plan)
        return PlanRun(checked, approvals, host)

    def stops(self, request: Request, is_stop: Callable[[Request], bool]) -> bool:
        """Return whether every step of a plan stops something."""
        return only_stops(request, is_stop)

    def show(self, command: Command) -> PlanState:
        """Return a plan as the list of plans shows it."""
        last = command.history[-1]
        given = command.input
        body = last.body
        if command.work is not None and not command.final:
            body = command.work.report(over=False)
        return PlanState(
            command=command.id,
            status=command.status,
            principal=command.principal,
            created=iso(command.created),
            name=given.get("name") if is_map(given) else getattr(given, "name", None),
            finished=None if command.finished is None else iso(command.finished),
            message=last.message,
            steps=[]
            if body is NO_BODY
            else (body.get("steps", []) if is_map(body) else body.steps),
        )
