"""What the gateway knows about one backend of the configuration: state, counts and stop plans."""

from __future__ import annotations

import time
from collections import Counter
from typing import Literal

import structlog

from rcp_kernel.clock import now
from rcp_kernel.config.file import BackendConfig
from rcp_kernel.errors import AdapterUnavailable, RcpError
from rcp_kernel.spi import StopPlan
from rcp_kernel.tree.entry import Availability

__all__ = ["BackendStatus", "State"]

log = structlog.get_logger("rcp.supervisor")
State = Literal[
    "declared", "opening", "ready", "degraded", "down", "closing", "closed", "unavailable", "failed"
]
_WIRE_STATE: dict[State, Availability] = {
    "declared": "starting",
    "opening": "starting",
    "ready": "ready",
    "degraded": "degraded",
}
"""The states of `/system/status`; every other one is `down` there."""
_FAULTS = 1.0  # s between log records of one backend's invalid values


class BackendStatus:
    """The record of one backend, over all its lives."""

    def __init__(self, config: BackendConfig) -> None:
        self.config = config
        self.name = config.name
        self.tenant = config.tenant
        self.robot = config.robot
        self.state: State = "declared"
        self.detail: str | None = None
        self.since = now()
        self.last_error: str | None = None
        self.latency: float | None = None
        """Seconds that the last call of the robot took."""
        self.samples = 0
        self.faults = 0
        self.refusals = Counter[str]()
        """How many were refused at the robots' side, by error code."""
        self.plans: dict[str, StopPlan] = {}
        """The mechanisms that stop its robots without the gateway, by name."""
        self.plans_changed = 0
        """Number of changes of these."""
        self._logged_at = float("-inf")

    @property
    def availability(self) -> Availability:
        """Whether it can be used, in the words of the wire."""
        return _WIRE_STATE.get(self.state, "down")

    def unavailable(self) -> RcpError:
        """Return the error with the reason why there is no backend now."""
        why = f": {self.detail}" if self.detail else ""
        return AdapterUnavailable(
            f"backend '{self.name}' is not connected ({self.state}){why}",
            origin=self.name,
            retry_after=1.0 if self.state in ("opening", "down") else None,
        )

    def fault(self, detail: str) -> None:
        """Record an invalid value; a stream of them is logged once a second."""
        self.faults += 1
        self.last_error = detail
        if time.monotonic() - self._logged_at > _FAULTS:
            self._logged_at = time.monotonic()
            log.warning("backend_fault", backend=self.name, detail=detail, faults=self.faults)

    def guard(self, name: str, plan: StopPlan | None) -> None:
        """Store a plan for the guard process."""
        self.plans.pop(name, None)
        if plan is not None:
            self.plans[name] = plan
        self.plans_changed += 1
