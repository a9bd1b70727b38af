"""Events of robots brought to rest: dead-man, e-stops, lost commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcp_kernel.contract.events import EventBus
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import RcpError
from rcp_kernel.safety.safe_value import safe_value
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_kernel.wire import Request

if TYPE_CHECKING:
    from rcp_kernel.safety.estop import EstopRequest

__all__ = ["SafetyEvents"]


class SafetyEvents:
    """Reports what the gateway does by itself for the safety of robots, and e-stops."""

    def __init__(self, events: EventBus) -> None:
        self._events = events

    def dead_man(self, entry: Entry, outcome: str) -> None:
        """Report that a command lapsed, or that the robot accepted the safe value."""
        self._events.note(
            "deadman",
            principal=None,
            tenant=entry.tenant,
            path=entry.path,
            outcome=outcome,
            value=None if outcome == "lapsed" else safe_value(entry),
        )

    def refused(self, backend: str, tenant: str, error: RcpError, count: int) -> None:
        """Report that a peer was refused at the robots' side of a backend."""
        self._events.note(
            "denial",
            principal=None,
            tenant=tenant,
            transport=f"backend {backend}",
            outcome=error.code,
            message=error.message,
            count=count,
        )

    def stop_step(self, unit: RobotUnit, step: str, detail: str | None) -> None:
        """Report that a robot under an e-stop was confirmed at rest, or that it moves again."""
        self._events.note(
            "stop",
            principal=None,
            tenant=unit.tenant,
            path=ESTOP,
            robot=unit.name,
            outcome=step,
            message=detail,
        )

    def recovered(self, unit: RobotUnit, command: str, done: str) -> None:
        """Report what was done with a robot whose command had been lost with its link."""
        self._events.note(
            "recovery",
            principal=None,
            tenant=unit.tenant,
            path=command,
            robot=unit.name,
            message=done,
        )

    def estop(
        self,
        session: Session,
        request: Request,
        body: EstopRequest,
        keys: dict[str, str | None],
        robots: list[RobotUnit],
    ) -> None:
        """Report an e-stop or its reset: in each tenant its latches and robots."""
        tenants = dict.fromkeys([*keys.values(), *(robot.tenant for robot in robots)])
        for tenant in tenants:
            self._events.note(
                "estop",
                principal=session.principal,
                session=session,
                request=request,
                tenant=tenant,
                path=ESTOP,
                reset=body.reset,
                scope=body.scope,
                latches=sorted(key for key, of in keys.items() if of in (None, tenant)),
                robots=[robot.name for robot in robots if robot.tenant == tenant],
                reason=body.reason,
            )
