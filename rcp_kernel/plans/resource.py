"""`/system/plans`: a plan as a command, and the list of those that run or ran."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterable, Iterator
from functools import partial
from typing import Any

from rcp_kernel._plain import is_map
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.clock import iso
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.turns import Turns
from rcp_kernel.errors import EstopActive, PayloadTooLarge, QueueFull
from rcp_kernel.features.approval import About, ApprovalService
from rcp_kernel.model import Operation
from rcp_kernel.plans.checks import PlanChecker
from rcp_kernel.plans.engine import Engine
from rcp_kernel.plans.model import PATH, Plan, PlanState
from rcp_kernel.plans.node import Checked, every
from rcp_kernel.plans.progress import ProgressReport
from rcp_kernel.plans.waiting import WaitingPlan, WaitingPlans
from rcp_kernel.requests.audit_writer import AuditWriter
from rcp_kernel.requests.command_access import CommandAccess
from rcp_kernel.requests.commands import Commands
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.resolver import Resolver
from rcp_kernel.sessions.session import Handler, Session
from rcp_kernel.spi import Progress
from rcp_kernel.tree.entry import Entry, StopGroup
from rcp_kernel.tree.registry import Registry
from rcp_kernel.values import ANY, Encoding, to_plain
from rcp_kernel.wire import NO_BODY, Body, Reply, Request

__all__ = ["PATH", "PlanList", "Plans", "Work"]

MakeEngine = Callable[[Session, Checked, str, ProgressReport], Engine]

_LISTED = 50  # plans
_STEP = 256  # paths that are looked at in one step


class Work:
    """A plan that may begin, as the work of a command."""

    def __init__(
        self,
        session: Session,
        checked: Checked,
        approvals: ApprovalService,
        changed: Callable[[], None],
        make_engine: MakeEngine,
        waiting: WaitingPlan,
        units: Iterable[StopGroup],
    ) -> None:
        self.waiting = waiting
        self._units = units
        self._checked = checked
        self._approvals = approvals
        self._changed = changed
        self._make_engine = make_engine
        self.asks = tuple(checked.asks)
        self.asked = tuple(n.path or "" for n in every(checked.nodes) if n.id in checked.asks)
        self.touches = tuple(checked.touches)
        self.tenant = session.tenant
        self.telling = ProgressReport(checked, changed)

    @property
    def plan(self) -> Plan:
        """The plan as it was sent."""
        return self._checked.plan

    def check_stops(self) -> None:
        """Refuse a plan that was sent before an e-stop on a robot that it is about.

        :raises EstopActive: it was, whether the e-stop is latched still or not.
        """
        for unit in self._units:
            if unit.stopped >= self.waiting.since:
                raise EstopActive(
                    f"{unit.name} was stopped while the plan waited for its turn",
                    remedy="Check the state of the robot, then send the plan again.",
                )

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

    def view(self, session: Session) -> Iterator[Body | None]:
        """List the plans that a session may see, newest first; None stands for any other command."""
        plans = (
            c if c is not None and c.path == PATH else None for c in self._access.judged(session)
        )
        left = _LISTED
        for command in plans:
            yield None if command is None else _Listed(command)
            left -= command is not None
            if not left:
                return


class _Listed(Body):
    """A plan as the list tells of it."""

    __slots__ = ("_command",)

    def __init__(self, command: Command) -> None:
        self._command = command

    @property
    def value(self) -> Any:
        """The plan as plain data."""
        return to_plain(_state(self._command))

    def encoded(self, encoding: Encoding) -> bytes:
        """Return it as bytes of the encoding."""
        return ANY.encode(_state(self._command), encoding)


class Plans:
    """Makes commands of plans."""

    def __init__(
        self,
        listed: PlanList,
        checker: PlanChecker,
        waiting: WaitingPlans,
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
        self.waiting = waiting
        self._resolver = resolver
        self._commands = commands
        self._approvals = approvals
        self._registry = registry
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

    def prepare(
        self, session: Session, request: Request, waiting: WaitingPlan
    ) -> Generator[None, None, Work]:
        """Check a plan whole, in steps.

        :raises PayloadTooLarge: it is longer than it may be.
        :raises RcpError: the session may send none, or something is wrong with it; see
            `PlanChecker.check`.
        """
        entry = self._resolver.resolve(session, PATH, Operation.EXECUTE)
        self._check_size(request)
        plan: Plan = request.decode_body(entry.input_type, f"input of {entry.label}")
        yield
        checked = yield from self._checker.check(session, plan)
        units = yield from self._units(checked)
        changed = self._listed.changed
        return Work(session, checked, self._approvals, changed, self._make_engine, waiting, units)

    def _units(self, checked: Checked) -> Generator[None, None, list[StopGroup]]:
        """Return what an e-stop stops of all that a plan is about."""
        found: dict[StopGroup, None] = {}
        for number, path in enumerate(checked.touches, 1):
            entry = self._registry.entries.get(path)
            if entry is not None:
                found[entry.unit] = None
            if not number % _STEP:
                yield
        return list(found)

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
