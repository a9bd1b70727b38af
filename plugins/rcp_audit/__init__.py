"""Audit log: tamper-evident records of actions and their outcomes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from prometheus_client.core import Metric

from rcp_audit.config import AuditConfig, AuditTables, from_gateway
from rcp_audit.disclosure import Disclosure
from rcp_audit.log import HISTORY, AuditLog
from rcp_audit.replies import DelayedReplies
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.access.acl import Rights
from rcp_kernel.contract.metrics import gauge
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.features.feature import StatusPart
from rcp_kernel.model import Resource

__all__ = ["AuditConfig", "rcp_features"]

_RESOURCE = Resource(
    name="event/audit",
    description="Records of commands, writes, refusals and logins in your tenants.",
    value=dict[str, Any],
    history=HISTORY,
)


def _make(tables: AuditTables, host: FeatureHost) -> Feature:
    log, disclosure = AuditLog(tables.audit, host), Disclosure(host.visibility)

    def reconfigure(tables: AuditTables) -> None:
        log.retention.config = tables.audit

    def status(rights: Rights | None) -> StatusPart:
        if rights is None:
            return StatusPart({})
        return StatusPart({"record": log.state(head=disclosure.concerns(rights, {}))})

    def metrics() -> Iterable[Metric]:
        broken = log.state(head=False)["state"] != "ok"
        yield gauge(
            "rcp_audit_degraded", "Whether records cannot be written.", (), [([], float(broken))]
        )
        waiting = float(host.ledger.waiting)
        yield gauge("rcp_audit_waiting", "Records that are not stored yet.", (), [([], waiting)])

    return Feature(
        metrics=metrics,
        resources=(SystemResource(resource=_RESOURCE, shows=disclosure.shown),),
        on_event=log.hear,
        on_command=log.records.follow,
        feedback=False,
        durability=DelayedReplies(host.ledger, host.loop) if host.ledger.keeps else None,
        status=status,
        reconfigure=reconfigure,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Provide the audit log."""
    return [FeatureKind("audit", AuditTables, _make, __doc__ or "", table=from_gateway)]
