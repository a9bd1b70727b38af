"""`/system/plans`: a plan as a command, and the list of those that run or ran."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any

from rcp_kernel._plain import is_map
from rcp_kernel.access.approvals import About
from rcp_kernel.clients.session import Session
from rcp_kernel.clock import iso
from rcp_kernel.errors import PayloadTooLarge, QueueFull
from rcp_kernel.model import Operation
from rcp_kernel.operations.command import Command
from rcp_kernel.plans.checks import check_plan, read_conditions
from rcp_kernel.plans.engine import Engine
from rcp_kernel.plans.model import PATH, Plan, PlanState
from rcp_kernel.plans.node import Checked, every
from rcp_kernel.plans.progress import ProgressReport
from rcp_kernel.registry import Entry
from rcp_kernel.spi import Progress
from rcp_kernel.values import to_plain
from rcp_kernel.wire import NO_BODY, Reply, Request

if TYPE_CHECKING:
    from rcp_kernel.gateway import Gateway

__all__ = ["PATH", "Plans", "Work"]

_LISTED = 50  # plans


class Work:
    """A plan that may begin, as the work of a command."""

    def __init__(self, gateway: Gateway, session: Session, checked: Checked) -> None:
        self._gateway = gateway
        self._checked = checked
        self.asks = tuple(checked.asks)
        self.asked = tuple(n.path or "" for n in every(checked.nodes) if n.id in checked.asks)
        self.touches = tuple(dict.fromkeys(checked.touches))
        self.tenant = session.tenant
        self.telling = ProgressReport(checked, self._changed)

    def _changed(self) -> None:
        self._gateway.plans.changed()

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
        self._gateway.approvals.demand(session, request, entry, shown, about)

    async def run(self, command: Command, session: Session, progress: Progress) -> Any:
        """Run the plan to its end, and return what became of each step."""
        self.telling.progress = progress
        token = self._gateway.approvals.open(self.asked) if self.asks else None
        engine = Engine(self._gateway, session, self._checked, command.id, self.telling)
        try:
            await engine.run(token)
        finally:
            self.telling.progress = None
            self._gateway.approvals.close(token)
        return self.telling.outcome(over=True)

    def report(self, *, over: bool) -> Any:
        """Return what has become of each step so far."""
        return self.telling.outcome(over=over)


class Plans:
    """The gateway's part in plans."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._told = True
        self.tell: Callable[[], None] = lambda: None
        """Called when the list may have changed: once for all that has in a turn of the loop."""

    def changed(self) -> None:
        """Take notice that the list may have changed."""
        if self._told:
            self._told = False
            self._gateway.loop.call_soon(self._tell)

    def _tell(self) -> None:
        self._told = True
        self.tell()

    def prepare(self, session: Session, request: Request, plan: Plan) -> Work:
        """Check a plan whole.

        :raises PayloadTooLarge: it is longer than it may be.
        :raises QueueFull: as many run as may.
        :raises RcpError: something is wrong with it; see `check_plan`.
        """
        limits = self._gateway.config.plans
        self._check_size(request)
        running = [c for c in self._gateway.commands.running.values() if c.path == PATH]
        if sum(1 for c in running if c.tenant == session.tenant) >= limits.running:
            raise QueueFull(
                f"{limits.running} plans of this tenant run already",
                remedy="Wait for one to end, or cancel one.",
                details={"limit": limits.running},
            )
        return Work(self._gateway, session, check_plan(self._gateway, session, plan))

    def _check_size(self, request: Request) -> None:
        size, limit = len(bytes(request.body)), self._gateway.config.plans.size
        if size > limit:
            raise PayloadTooLarge(
                f"the plan has {size} bytes; the limit is {limit}", details={"limit": limit}
            )

    def read_conditions(self, session: Session, request: Request) -> Generator[None]:
        """Read the conditions of a plan in steps, so that `prepare` does not take long.

        :raises RcpError: the session may send none, it is none or too long, or its conditions
            cannot be read now.
        """
        entry = self._gateway.resolve(session, PATH, Operation.EXECUTE)
        self._check_size(request)
        plan = request.decode_body(entry.input_type, f"input of {entry.label}")
        yield
        yield from read_conditions(self._gateway, session, plan)

    def view(self, session: Session) -> list[dict[str, Any]]:
        """List the plans that a session may see, newest first."""
        found = [
            command
            for command in self._gateway.commands.every()
            if command.path == PATH and self._gateway.executing.sees(session, command)
        ]
        return [to_plain(_state(c)) for c in found[:_LISTED]]


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
