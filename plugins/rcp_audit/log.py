"""The audit log: one sealed record per event, with actor, decision and outcome.

Records are bounded: a long value is replaced by its length and SHA-256.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import msgspec

from rcp_audit.config import AuditConfig
from rcp_audit.facts import ACTS, accepted, ended, requested, who_did
from rcp_audit.retention import Retention
from rcp_audit.throttle import DenialThrottle
from rcp_kernel.contract.digest import bounded
from rcp_kernel.contract.events import Event
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.touches import bounded_touches
from rcp_kernel.features import FeatureHost
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.wire import FINAL
from rcp_store.chain import written

__all__ = ["FULL", "PATH", "AuditLog"]

PATH = "/system/audit"
HISTORY = 1000
"""Records kept in memory for `history`."""
FULL = 5000
"""Pending records above which commands and writes are refused, and refusals only counted."""
_MOST = 20_000  # pending records above which events are only counted
_TEXT = 500  # characters of a message
_SESSIONS = 1024  # of which, and of whose paths, the first fields are remembered
_Known = tuple[Principal | None, str | None, dict[str, Any]]
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


class _Sealed(msgspec.Struct, frozen=True, gc=False):
    """A sealed record, decoded on demand: a `Native` value."""

    data: bytes

    def decode(self) -> dict[str, Any]:
        """Return the record."""
        return msgspec.json.decode(self.data)


class AuditLog:
    """Writes one record for each event, and for each start and end of a command."""

    def __init__(self, config: AuditConfig, host: FeatureHost) -> None:
        self._host = host
        self._publish = host.publish
        self._ledger = host.ledger
        self._store = host.ledger.store
        self._known: dict[tuple[str | None, str | None, str], _Known] = {}
        self.throttle = DenialThrottle(host.loop, config.denials, partial(self._write, "denials"))
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
                return (acts or event.outcome in _DENIALS) and self._record("denial", event)
            case "write":
                what = "denial" if event.outcome in _DENIALS else "write"
                return self._record(what, event)
            case "start":
                self._start(event)
            case "stop":
                self.retention.stop()
                self.throttle.close()
                self._record("stop", event)
            case what:
                return self._record(what, event)
        return True

    def follow(self, command: Command, step: Record) -> None:
        """Record that a command was accepted, and its outcome."""
        if step.status == "accepted":
            self._record("execute", accepted(command))
        elif step.status in FINAL:
            self._record("command", ended(command, step))

    def _start(self, event: Event) -> None:
        """Record the start of the gateway, with the head that the previous run left behind."""
        for record in self._ledger.past(HISTORY):
            self._host.publish(PATH, record)
        left = self._ledger.left
        self._record("start", event, head=left and written(left))
        self.retention.start()

    def _record(self, what: str, event: Event, **more: Any) -> bool:
        touches = None if event.touches is None else bounded_touches(event.touches)
        facts = who_did(event, touches) if touches is not None else self._who(event)
        # A flood of refusals gets one common record.
        if (what == "denial" or self._store.waiting > _MOST) and not self._passes(
            what, event, dict(facts)
        ):
            return False
        if event.path is not None:
            facts["path"] = event.path[:_TEXT]
        if more:
            facts |= more
        if event.request is not None:
            facts |= requested(event.request, event.what, hide=event.hide)
        for key, value in event.facts.items():
            if value is not None:
                facts[key] = value[:_TEXT] if isinstance(value, str) and key != "value" else value
        value = facts.get("value")
        if value is not None and type(value) is not msgspec.Raw:
            facts["value"] = bounded(value)
        if touches is not None:
            facts["touches"] = list(touches)
        facts["outcome"] = event.outcome
        self._write(what, facts)
        return True

    def _who(self, event: Event) -> dict[str, Any]:
        """Return what `who_did` does, which is the same for all events of a session at one path."""
        session = event.session
        if session is None:
            return who_did(event, None)
        key = (event.path, event.tenant, session.id)
        known = self._known.get(key)
        # A `hello` gives a session another principal, and perhaps another tenant.
        if known is None or known[0] is not event.principal or known[1] != session.tenant:
            if len(self._known) >= _SESSIONS:
                self._known.clear()
            known = self._known[key] = event.principal, session.tenant, who_did(event, None)
        return {**known[2]}

    def _passes(self, what: str, event: Event, who: dict[str, Any]) -> bool:
        """Return whether a refusal, or an event beyond the limit, gets its own record."""
        ledger, refusal = self._ledger, what == "denial"
        waiting = ledger.waiting
        principal = event.principal
        key = f"{event.facts.get('transport')}" if principal is None else f"={principal.name}"
        broken = refusal and ledger.trouble is not None
        full = broken or waiting > (FULL if refusal else _MOST)
        return self.throttle.passes(key, who, event.path, event.outcome, full=full)

    def _write(self, what: str, facts: dict[str, Any]) -> None:
        try:
            data = self._ledger.add(what, facts)
        except (TypeError, ValueError, OverflowError, RecursionError):
            data = self._ledger.add(what, {k: v and bounded(v) for k, v in facts.items()})
        if self._store.keeps:
            self._ledger.settled(partial(self._publish, PATH, _Sealed(data)))
        else:
            self._publish(PATH, _Sealed(data))

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
