"""The approval functions used by plans and adapters, as one object."""

from __future__ import annotations

from rcp_approvals.decisions import Decisions
from rcp_approvals.guard import ApprovalGuard
from rcp_approvals.questions import Questions

__all__ = ["Approvals"]


class Approvals:
    """The `ApprovalService` of this feature; delegates to its parts."""

    def __init__(self, questions: Questions, guard: ApprovalGuard, decisions: Decisions) -> None:
        self.wanted = guard.wanted
        self.demand = questions.demand
        self.open = guard.open
        self.close = guard.close
        self.answer = decisions.answer
        self.follow = questions.follow
