"""The guard of approvals: a command that requires approval passes once after it is approved."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from typing import Any

from rcp_approvals.config import ApprovalsConfig
from rcp_approvals.questions import Questions
from rcp_kernel.features import Call, Guard, Slot
from rcp_kernel.features.approval import About
from rcp_kernel.safety.safe_value import is_safe
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry

__all__ = ["ApprovalGuard"]


class ApprovalGuard(Guard):
    """Holds back commands that require a person's approval."""

    slot = Slot.APPROVAL

    def __init__(self, questions: Questions) -> None:
        self._questions = questions
        self.active = questions.config.asked
        self._tokens: dict[str, frozenset[str]] = {}
        """Paths that the steps of a running, approved plan may command."""

    def configure(self, config: ApprovalsConfig) -> None:
        """Apply a configuration: whether any role requires approvals, and for how long they count."""
        self.active = config.asked
        self._questions.config = config

    @staticmethod
    def wanted(session: Session, entry: Entry, value: Any) -> bool:
        """Return whether a command requires approval; bringing an actuator to rest never does."""
        if not session.rights.asks(entry.path):
            return False
        return not is_safe(entry, value)

    def dry_run(self, call: Call) -> Mapping[str, Any]:
        """Return whether approval would be required, for a dry run."""
        return {"approval": self.wanted(call.session, call.entry, call.value) or None}

    def admit(self, call: Call) -> None:
        """Refuse a command without its required approval; otherwise use the approval up.

        :raises ApprovalRequired, Forbidden: as `ApprovalService.demand`.
        """
        session, request, entry = call.session, call.request, call.entry
        if request.dry_run or not self.wanted(session, entry, call.value):
            return
        if call.together:
            self._admit_together(call)
            return
        covered = self._tokens.get(request.approval or "")
        if covered is not None and entry.path in covered:
            return
        about = About((entry.path,), (entry.path,))
        self._questions.demand(session, request, entry, call.value, about)

    def _admit_together(self, call: Call) -> None:
        """Demand one approval for all values of a write of several paths: at the first of them."""
        session, entry = call.session, call.entry
        asked = [e for e, value in call.together if self.wanted(session, e, value)]
        covered = self._tokens.get(call.request.approval or "", frozenset())
        if entry is not asked[0] or all(e.path in covered for e in asked):
            return
        paths = tuple(e.path for e in asked)
        seen = tuple(e.path for e, _ in call.together)
        value = {e.path: value for e, value in call.together}
        self._questions.demand(session, call.request, entry, value, About(paths, seen))

    def confirm(self, call: Call) -> None:
        """Do nothing: the approval was used up on admission."""

    def open(self, paths: tuple[str, ...]) -> str:
        """Return a token that admits the steps of an approved plan, until `close`."""
        token = "plan-" + secrets.token_hex(16)
        self._tokens[token] = frozenset(paths)
        return token

    def close(self, token: str | None) -> None:
        """Revoke a token."""
        self._tokens.pop(token or "", None)
