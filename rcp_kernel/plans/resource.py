"""`/system/plans`: a plan as a command, and the list of those that run or ran."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from functools import partial
from typing import Any

from rcp_kernel._plain import is_map
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.access.resolver import Resolver
from rcp_kernel.clients.session import Handler, Session
from rcp_kernel.clock import iso
from rcp_kernel.config.settings import Settings
from rcp_kernel.errors import PayloadTooLarge, QueueFull
from rcp_kernel.features.approval import About, ApprovalService
from rcp_kernel.model import Operation
from rcp_kernel.operations.command import Command
from rcp_kernel.operations.command_access import CommandAccess
from rcp_kernel.operations.commands import Commands
from rcp_kernel.plans.checks import PlanChecker, read_conditions
from rcp_kernel.plans.engine import Engine
from rcp_kernel.plans.model import PATH, Plan, PlanState
from rcp_kernel.plans.node import Checked, every
from rcp_kernel.plans.progress import ProgressReport
from rcp_kernel.record.audit_writer import AuditWriter
from rcp_kernel.registry import Entry, Registry
from rcp_kernel.spi import Progress
from rcp_kernel.turns import Turns
from rcp_kernel.values import to_plain
from rcp_kernel.wire import NO_BODY, Reply, Request

__all__ = ["PATH", "PlanList", "Plans", "Work"]

MakeEngine = Callable[[Session, Checked, str, ProgressReport], Engine]

_LISTED = 50  # plans


class Work:
    """A plan that may begin, as the work of a command."""

    def __init__(
        self,
        session: Session,
        checked: Checked,
        approvals: ApprovalService,
        changed: Callable[[], None],
        make_engine: MakeEngine,
    ) -> None:
        self._checked = checked
        self._approvals = approvals
        self._changed = changed
        self._make_engine = make_engine
        self.asks = tuple(checked.asks)
        self.asked = tuple(n.path or "" for n in every(checked.nodes) if n.id in checked.asks)
        self.touches = tuple(dict.fromkeys(checked.touches))
        self.tenant = session.tenant
        self.telling = ProgressReport(checked, changed)

    def told(self, reply: Reply) -> None:
        """Take notice of a reply of the command: where it begins and ends, the list changes."""
        if reply.status != "in_progress":
            self._changed()

    def would(self) -> dict[str, Any]:
        """Tell a dry run what would be sent, and whether a person has to approve it."""
        out: dict[str, Any] = {"steps": self._checked.plain()}
        return out | ({"approval": list(self.asks)} if self.asks else {})

    def approve(self, session: Session, request: Request, entry: Entry) -> None:
        """Let the plan's steps pass if a person has approved it, or none has to.

        :raises ApprovalRequired, Forbidden: nobody has.
        """
        if not self.asks:
            return
        about = About(self.asked, (*self.asked, *self.touches), self.asks)
        # With what it means now: names and relative paths may come to mean something else.
        shown = {"plan": self._checked.plan, "steps": self._checked.plain()}
        self._approvals.demand(session, request, entry, shown, about)

    async def run(self, command: Command, session: Session, progress: Progress) -> Any:
        """Run the plan to its end, and return what became of each step."""
        self.telling.progress = progress
        token = self._approvals.open(self.asked) if self.asks else None
        engine = self._make_engine(session, self._checked, command.id, self.telling)
        try:
            await engine.run(token)
        finally:
            self.telling.progress = None
            self._approvals.close(token)
        return self.telling.outcome(over=True)

    def report(self, *, over: bool) -> Any:
        """Return what has become of each step so far."""
        return self.telling.outcome(over=over)


class PlanList:
    """The plans that run or ran lately."""

    def __init__(self, access: CommandAccess, loop: asyncio.AbstractEventLoop) -> None:
        self._access = access
        self._loop = loop
        self._told = True
        self.on_change: list[Callable[[], None]] = []
        """Called when the list may have changed: once for all that has in a turn of the loop."""

    def changed(self) -> None:
        """Take notice that the list may have changed."""
        if self._told:
            self._told = False
            self._loop.call_soon(self._tell)

    def _tell(self) -> None:
        self._told = True
        for changed in self.on_change:
            changed()

    def view(self, session: Session) -> list[dict[str, Any]]:
        """List the plans that a session may see, newest first."""
        found = [command for command in self._access.visible(session) if command.path == PATH]
        return [to_plain(_state(c)) for c in found[:_LISTED]]


class Plans:
    """Makes commands of plans."""

    def __init__(
        self,
        listed: PlanList,
        checker: PlanChecker,
        *,
        handle: Handler,
        resolver: Resolver,
        commands: Commands,
        approvals: ApprovalService,
        conditions: Conditions,
        registry: Registry,
        audit_writer: AuditWriter,
        settings: Settings,
        turns: Turns,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._listed = listed
        self._checker = checker
        self._resolver = resolver
        self._commands = commands
        self._approvals = approvals
        self._conditions = conditions
        self._settings = settings
        self._make_engine = partial(
            Engine,
            handle=handle,
            commands=commands,
            conditions=conditions,
            registry=registry,
            audit_writer=audit_writer,
            turns=turns,
            loop=loop,
        )

    def prepare(self, session: Session, request: Request, plan: Plan) -> Work:
        """Check a plan whole.

        :raises PayloadTooLarge: it is longer than it may be.
        :raises RcpError: something is wrong with it; see `check_plan`.
        """
        self._check_size(request)
        checked = self._checker.check(session, plan)
        return Work(session, checked, self._approvals, self._listed.changed, self._make_engine)

    def check_running(self, session: Session) -> None:
        """Refuse one plan too many.

        :raises QueueFull: as many of its tenant run as may.
        """
        limits = self._settings.config.plans
        running = [c for c in self._commands.running.values() if c.path == PATH]
        if sum(1 for c in running if c.tenant == session.tenant) >= limits.running:
            raise QueueFull(
                f"this tenant already has {limits.running} plans running",
                remedy="Wait until one ends, or cancel one.",
                details={"limit": limits.running},
            )

    def _check_size(self, request: Request) -> None:
        size, limit = len(bytes(request.body)), self._settings.config.plans.size
        if size > limit:
            raise PayloadTooLarge(
                f"the plan has {size} bytes; the limit is {limit}", details={"limit": limit}
            )

    def read_conditions(self, session: Session, request: Request) -> Generator[None]:
        """Read the conditions of a plan in steps, so that `prepare` does not take long.

        :raises RcpError: the session may send none, it is none or too long, or its conditions
            cannot be read now.
        """
        entry = self._resolver.resolve(session, PATH, Operation.EXECUTE)
        self._check_size(request)
        plan = request.decode_body(entry.input_type, f"input of {entry.label}")
        yield
        yield from read_conditions(self._conditions, session, plan)


def _state(command: Command) -> PlanState:
    last = command.history[-1]
    given = command.input
    if command.work is not None and not command.final:
        body: Any = command.work.report(over=False)
    else:
        body = last.body
    return PlanState(
        command=command.id,
        status=command.status,
        principal=command.principal,
        created=iso(command.created),
        name=given.get("name") if is_map(given) else getattr(given, "name", None),
        finished=None if command.finished is None else iso(command.finished),
        message=last.message,
        steps=[] if body is NO_BODY else _steps(body),
    )


def _steps(body: Any) -> list[Any]:
    return body.get("steps", []) if is_map(body) else body.steps
