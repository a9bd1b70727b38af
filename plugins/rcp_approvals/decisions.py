"""Decisions on approvals, and their audit records."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_approvals.question import PATH, ApprovalRequest, ApprovalState, Question
from rcp_approvals.questions import Questions
from rcp_kernel.contract.digest import bounded, hashed
from rcp_kernel.contract.identity import same
from rcp_kernel.errors import Forbidden, UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.approval import Decision
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import to_plain

__all__ = ["Decisions"]


class Decisions:
    """Shows approvals to those concerned, and accepts their decisions."""

    def __init__(self, questions: Questions, host: FeatureHost) -> None:
        self._questions = questions
        self._host = host

    def view(self, session: Session) -> list[dict[str, Any]]:
        """List the approvals that a session may decide on or has requested, newest first."""
        every = reversed(self._questions.known.values())
        return [to_plain(q.state) for q in every if self._sees(session, q) and q.status]

    def request(
        self, session: Session, decision: ApprovalRequest, *, dry_run: bool
    ) -> ApprovalState | None:
        """Decide as a principal other than the requester.

        :raises UnknownPath: this principal has no such approval.
        :raises Forbidden: it may not decide, or the approval is no longer pending.
        """
        found = self._find(session, decision.id)
        if same(session.principal, found.asker):  # also by another of their credentials
            raise Forbidden(
                "you cannot approve your own command",
                path=PATH,
                remedy="Ask someone else whose role has `may_approve = true`.",
            )
        if not self._may_decide(session, found):
            raise _may_not(session)
        _check_open(found)
        if dry_run:
            return None
        self._decide(session, found, decision.decision, decision.reason, at="gateway")
        return msgspec.structs.replace(found.state)

    def answer(self, session: Session, id_: str, decision: Decision, reason: str | None) -> None:
        """Decide as the person at the session's client.

        :raises RcpError: as `ApprovalService.answer`.
        """
        session.charge()
        found = self._find(session, id_)
        own = same(session.principal, found.asker)
        rights = session.rights
        if own and decision == "approve" and not all(map(rights.may_approve_own, found.tenants)):
            raise Forbidden(
                f"{session.principal.name} may not approve its own commands",
                path=PATH,
                remedy="Ask someone else whose role has `may_approve = true`.",
            )
        if not own and not self._may_decide(session, found):
            raise _may_not(session)
        _check_open(found)
        self._decide(session, found, decision, reason, at="client")

    def _find(self, session: Session, id_: str) -> Question:
        found = self._questions.known.get(id_)
        if found is None or not self._sees(session, found):
            raise UnknownPath(f"there is no approval '{id_[:64]}'", remedy=f"Read {PATH}.")
        return found

    def _may_decide(self, session: Session, question: Question) -> bool:
        rights = session.rights
        return all(map(rights.may_approve, question.tenants)) and self._host.sees_all(
            rights, question.seen
        )

    def _sees(self, session: Session, question: Question) -> bool:
        return session.principal.identity == question.requester or self._may_decide(
            session, question
        )

    def _decide(
        self,
        session: Session,
        question: Question,
        decision: Decision,
        reason: str | None,
        *,
        at: str,
    ) -> None:
        state = question.state
        state.status = "approved" if decision == "approve" else "rejected"
        state.by, state.reason = session.principal.name, reason
        plan = bool(state.steps)
        shown: Any = bounded(state.value)
        self._host.note(
            "approval",
            principal=session.principal,
            session=session,
            tenant=min(question.tenants) or None,
            path=state.path,
            touches=question.seen if plan else None,
            outcome=state.status,
            approval=state.approval,
            asker=state.principal,
            request=state.request,
            # The values of a plan are reported with the requests of its steps.
            value=hashed(msgspec.json.encode(shown)) if plan else shown,
            steps=list(state.steps) or None,
            reason=reason,
            at=at,
        )
        self._questions.decided(question)


def _check_open(question: Question) -> None:
    if question.status != "pending":
        raise Forbidden(
            f"the approval is already {question.status}",
            path=PATH,
            remedy="Send the command again to request a new approval.",
        )


def _may_not(session: Session) -> Forbidden:
    return Forbidden(
        f"{session.principal.name} may not approve commands on these paths",
        path=PATH,
        remedy="Ask someone whose role has `may_approve = true`.",
    )
