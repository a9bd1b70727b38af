"""A checked plan as the work of a command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcp_kernel.features import ActionHost
from rcp_kernel.features.approval import About, ApprovalService
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import Progress
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request
from rcp_plans.engine import Engine
from rcp_plans.model import Plan, PlanResult
from rcp_plans.node import Checked
from rcp_plans.outline import outline
from rcp_plans.progress import ProgressReport

__all__ = ["PlanRun"]


class PlanRun:
    """A plan that may start."""

    def __init__(self, checked: Checked, approvals: ApprovalService, host: ActionHost) -> None:
        self._checked = checked
        self._approvals = approvals
        self._host = host
        self._asks = tuple(checked.asks)
        self._asked = tuple(checked.asked)
        self.touches = tuple(checked.touches)
        self._telling = ProgressReport(checked)

    @property
    def input(self) -> Plan:
        """The plan as it was sent."""
        return self._checked.plan

    def dry_run(self) -> dict[str, Any]:
        """Return what would be sent, and which steps require approval."""
        out: dict[str, Any] = {"steps": self._checked.plain()}
        return out | ({"approval": list(self._asks)} if self._asks else {})

    def begin(self, session: Session, request: Request, entry: Entry) -> None:
        """Check the approval of the plan, if it requires one.

        :raises ApprovalRequired, Forbidden: it is not approved.
        """
        if not self._asks:
            return
        about = About(self._asked, (*self._asked, *self.touches), self._asks)
        # With the current paths: names and relative paths may be resolved differently later.
        shown = {"plan": self._checked.plan, "steps": self._checked.plain()}
        self._approvals.demand(session, request, entry, shown, about)

    async def run(self, command: Command, session: Session, progress: Progress) -> PlanResult:
        """Run the plan to its end, and return the outcome of each step."""
        self._telling.progress = progress
        token = self._approvals.open(self._asked) if self._asks else None
        engine = Engine(session, self._checked, command.id, self._telling, self._host)
        try:
            await engine.run(token)
        finally:
            self._telling.progress = None
            self._approvals.close(token)
        return self._telling.outcome(over=True)

    def report(self, *, over: bool) -> PlanResult:
        """Return the state of each step."""
        return self._telling.outcome(over=over)

    def outline(self, report: Any) -> Mapping[str, Any]:
        """Return the steps without values, which are in the records of their own paths."""
        steps = outline(report)
        return {} if steps is None else {"steps": steps}
