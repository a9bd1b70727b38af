"""Pending and recently decided approvals.

Kept in memory: after a restart, approvals must be requested again.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from typing import Any

from rcp_approvals.config import ApprovalsConfig
from rcp_approvals.question import PATH, ApprovalState, Question, digest_of, rejected, shown
from rcp_kernel.clock import iso
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import ApprovalRequired, Forbidden, QueueFull
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.approval import ID, About
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request

__all__ = ["Questions"]

_EACH = 64  # approvals requested by one principal
_ALL = 4096


class Questions:
    """Creates and stores approvals, and lets each approved command pass once."""

    def __init__(self, config: ApprovalsConfig, host: FeatureHost) -> None:
        self.config = config
        self._host = host
        self._clock = host.clock
        self.known: dict[str, Question] = {}
        """By id, oldest first."""

        self._followers: dict[str, list[Callable[[], None]]] = {}

    def follow(self, id_: str, decided: Callable[[], None]) -> Callable[[], None]:
        """Call `decided` once there is a decision, as `ApprovalService.follow`."""
        following = self._followers.setdefault(id_, [])
        following.append(decided)

        def stop() -> None:
            if decided in following:
                following.remove(decided)
            if not following:
                self._followers.pop(id_, None)

        return stop

    def decided(self, question: Question) -> None:
        """Notify who follows an approval, and subscribers."""
        self.changed()
        for callback in self._followers.pop(question.state.approval, ()):
            self._host.loop.call_soon(callback)

    def changed(self) -> None:
        """Notify subscribers that the list has changed."""
        self._host.changed(PATH)

    def demand(
        self, session: Session, request: Request, entry: Entry, value: Any, about: About
    ) -> None:
        """Use an approval, or request one.

        :raises ApprovalRequired, Forbidden: as `ApprovalService.demand`.
        """
        digest = digest_of(session.principal, request.type, entry.path, value)
        if request.approval is not None:
            self._use(session, request, request.approval, digest, entry.path)
            return
        question = self._same(session, digest) or self._ask(
            session, request, entry, value, about, digest
        )
        state = question.state
        if question.status == "rejected":
            raise rejected(state)
        raise ApprovalRequired(
            f"`{state.request} {state.path}` requires approval",
            path=entry.path,
            remedy=f"Ask for approval at {PATH}, then send the same command again with `approval`: "
            f"'{state.approval}'.",
            details={
                "approval": state.approval,
                "expires": state.expires,
                **({"steps": list(about.steps)} if about.steps else {}),
            },
        )

    def _same(self, session: Session, digest: bytes) -> Question | None:
        own = (q for q in self.known.values() if q.requester == session.principal.identity)
        return next((q for q in own if q.digest == digest and q.holds), None)

    def _ask(
        self,
        session: Session,
        request: Request,
        entry: Entry,
        value: Any,
        about: About,
        digest: bytes,
    ) -> Question:
        self._make_room(session.principal)
        moment, clock, ttl = self._clock.now(), self._clock, self.config.ttl
        until = clock.monotonic() + ttl, moment + int(ttl * 1e9)
        state = ApprovalState(
            approval=ID + secrets.token_hex(8),
            request="write" if request.type == "write" else "execute",
            path=entry.path,
            principal=session.principal.name,
            asked=iso(moment),
            expires=iso(until[1]),
            value=shown(value),
            steps=about.steps,
        )
        tenants = frozenset(tenant_of(path) or "" for path in about.paths)
        question = Question(state, session.principal, about.seen, tenants, until, digest, clock)
        self.known[state.approval] = question
        self._host.loop.call_later(ttl + 0.01, self.changed)
        self.changed()
        return question

    def _make_room(self, principal: Principal) -> None:
        """Remove old approvals to make room for a new one.

        :raises QueueFull: too many are pending.
        """
        own = [q for q in self.known.values() if q.requester == principal.identity]
        if sum(q.status == "pending" for q in own) >= _EACH:
            raise QueueFull(
                f"{principal.name} already has {_EACH} commands waiting for approval",
                remedy="Wait until they are decided or expire.",
            )
        if len(self.known) >= _ALL:
            self._drop()
        for over in [q for q in own if q.over][:-_EACH]:
            del self.known[over.state.approval]

    def _drop(self) -> None:
        """Remove the oldest approval: a finished one, or one of the tenants with the most."""
        counts = Counter(question.tenants for question in self.known.values())
        most = max(counts, key=lambda tenants: counts[tenants])
        every = self.known.items()
        over = next((id_ for id_, q in every if q.over), None)
        del self.known[over or next(id_ for id_, q in every if q.tenants == most)]

    def _use(self, session: Session, request: Request, id_: str, digest: bytes, path: str) -> None:
        question = self.known.get(id_)
        if (
            question is None
            or question.requester != session.principal.identity
            or question.digest != digest
        ):
            raise Forbidden(
                "the approval is for a different command, value or principal",
                path=path,
                remedy="Send the command without `approval` to request a new one.",
            )
        if question.status == "rejected":
            raise rejected(question.state)
        if question.status == "pending":
            raise ApprovalRequired(
                f"`{question.state.request} {path}` is not approved yet",
                path=path,
                remedy=f"Wait until {PATH} shows it as approved, then send the same command again.",
                details={"approval": id_, "expires": question.state.expires},
            )
        if question.status != "approved":
            raise Forbidden(
                f"the approval is {question.status}; an approval is valid for one command, until "
                "it expires",
                path=path,
                remedy="Send the command without `approval` to request a new one.",
            )
        self._host.check_place(session, request)  # or it would be used up for nothing
        question.state.status = "used"
        self.changed()
