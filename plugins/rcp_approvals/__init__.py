"""Approvals: operations marked in a role wait until a person approves them, once."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_approvals.config import ApprovalsConfig, from_gateway
from rcp_approvals.decisions import Decisions
from rcp_approvals.guard import ApprovalGuard
from rcp_approvals.question import ApprovalRequest, ApprovalState
from rcp_approvals.questions import Questions
from rcp_approvals.service import Approvals
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.features.approval import APPROVALS
from rcp_kernel.model import Operation, Resource

__all__ = ["ApprovalRequest", "ApprovalState", "ApprovalsConfig", "rcp_features"]

_RESOURCE = Resource(
    name="service/approvals",
    description="Commands that a person has to approve first: list, approve, reject.",
    value=list[ApprovalState],
    input=ApprovalRequest,
    output=ApprovalState,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=({"id": "a-0123456789abcdef", "decision": "approve", "reason": "I see it"},),
    history=1,
)


def _make(config: ApprovalsConfig, host: FeatureHost) -> Feature:
    questions = Questions(config, host)
    guard, decisions = ApprovalGuard(questions), Decisions(questions, host)

    return Feature(
        resources=(
            SystemResource(resource=_RESOURCE, view=decisions.view, execute=decisions.request),
        ),
        guard=guard,
        dry_run=guard.dry_run,
        services={APPROVALS: Approvals(questions, guard, decisions)},
        reconfigure=guard.configure,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `approvals`."""
    kind = FeatureKind("approvals", ApprovalsConfig, _make, __doc__ or "", table=from_gateway)
    return [kind]
