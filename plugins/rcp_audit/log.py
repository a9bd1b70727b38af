"""The audit log: which events are recorded, and what becomes of the log as a whole."""

from __future__ import annotations

from typing import Any

from rcp_audit.config import AuditConfig
from rcp_audit.records import ACTS, PATH, Records
from rcp_audit.retention import Retention
from rcp_kernel.contract.events import Event
from rcp_kernel.features import FeatureHost
from rcp_store.chain import written

__all__ = ["HISTORY", "AuditLog"]

HISTORY = 1000
"""Records kept in memory for `history`."""
_DENIALS = frozenset(
    (
        "unauthenticated",
        "token_expired",
        "forbidden",
        "unknown_path",  # also the answer for hidden paths
        "approval_required",
        "lease_required",
        "lease_held",
        "lease_lost",
        "estop_active",
        "mode_forbids",
        "precondition_failed",
        "stale_command",
        "out_of_range",
        "rate_limited",
    )
)
"""Codes recorded for every type of request; writes and executes are recorded with any code."""


class AuditLog:
    """Writes one record for each event, and for each start and end of a command."""

    def __init__(self, config: AuditConfig, host: FeatureHost) -> None:
        self._host = host
        self._ledger = host.ledger
        self.records = Records(host, config.denials)
        self.retention = Retention(host, config)

    def hear(self, event: Event) -> bool:
        """Record an event; returns at once.

        It belongs to its tenant and path. An event about several paths names them in `touches`; only
        readers who may see all of them, in all of their tenants, may see it.

        Returns whether the event got its own record: refusals beyond the limit are only counted.
        """
        match event.what:
            case "denial":
                acts = event.request is not None and event.request.type in ACTS
                return (acts or event.outcome in _DENIALS) and self.records.note("denial", event)
            case "write":
                what = "denial" if event.outcome in _DENIALS else "write"
                return self.records.note(what, event)
            case "start":
                self._start(event)
            case "stop":
                self.retention.stop()
                self.records.throttle.close()
                self.records.note("stop", event)
            case what:
                return self.records.note(what, event)
        return True

    def _start(self, event: Event) -> None:
        """Record the start of the gateway, with the head that the previous run left behind."""
        self.records.begin(self._host)
        last: str | None = None
        for record in self._ledger.past(HISTORY):
            self._host.publish(PATH, record)
            last = str(record.get("time"))
        left = self._ledger.left
        self.records.note("start", event, head=left and written(left))
        self.retention.start(last)

    def state(self, *, head: bool) -> dict[str, Any]:
        """Describe the log for `/system/status`; `head` adds its head, which not everybody may see."""
        ledger = self._ledger
        trouble = ledger.trouble or (ledger.damage and f"store damaged: {ledger.damage}")
        trouble = trouble or self._host.fault
        state = {"state": "degraded" if trouble else "ok", "kept": ledger.keeps}
        facts = {"waiting": ledger.waiting or None, "detail": trouble}
        if head and ledger.committed is not None:
            facts["head"] = written(ledger.committed)
        return state | {key: value for key, value in facts.items() if value is not None}
