"""What a person has to approve first: by rule, for one command of one principal, once.

Kept in memory: a restart forgets what was asked and approved, and it is asked anew.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import Meta

from rcp_kernel.access.identity import Principal
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.clients.session import Session
from rcp_kernel.clock import iso, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.errors import ApprovalRequired, Forbidden, QueueFull, RcpError, UnknownPath
from rcp_kernel.model import Kind, tenant_of
from rcp_kernel.motion.safety import safe_value
from rcp_kernel.record.audit import Audit, bounded, hashed
from rcp_kernel.record.audit_writer import ID
from rcp_kernel.registry import Entry
from rcp_kernel.types import Time
from rcp_kernel.values import Encoding, dump, to_plain
from rcp_kernel.wire import Request

__all__ = ["About", "ApprovalRequest", "ApprovalState", "Approvals", "Decision"]

PATH = "/system/approvals"
_EACH = 64  # that one principal may have asked for
_ALL = 4096
_SHOWN = 65_536  # bytes of a value; of a longer one its length is shown
Decision = Literal["approve", "reject"]
_Status = Literal["pending", "approved", "rejected", "used", "expired"]


class ApprovalRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Decide on what somebody asked for."""

    id: Annotated[str, Meta(max_length=64)]
    decision: Decision
    reason: Annotated[str, Meta(max_length=500)] | None = None


class ApprovalState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """Something that wants a person's approval, and what became of it."""

    approval: str
    """Its id."""
    request: Literal["write", "execute"]
    path: str
    principal: str
    """Who asks."""
    status: _Status = msgspec.field(default_factory=lambda: "pending")  # always written
    asked: Time
    expires: Time
    value: Any = None
    """What would be sent."""
    steps: tuple[str, ...] = ()
    """Of a plan: the steps that want it."""
    by: str | None = None
    """Who decided."""
    reason: str | None = None


class About(NamedTuple):
    """What a command that wants approval is about."""

    paths: tuple[str, ...]
    """Those for which it wants it."""
    seen: tuple[str, ...]
    """All that whoever decides has to see."""
    steps: tuple[str, ...] = ()
    """Of a plan: those that want it."""


class _Asked:
    """One question."""

    __slots__ = ("asker", "digest", "expires", "seen", "state", "tenants")

    def __init__(
        self,
        state: ApprovalState,
        asker: tuple[str, str],
        seen: tuple[str, ...],
        tenants: frozenset[str],
        expires: int,
        digest: bytes,
    ) -> None:
        self.state = state
        self.asker = asker
        self.seen = seen
        self.tenants = tenants
        self.expires = expires
        self.digest = digest

    @property
    def status(self) -> _Status:
        """What has become of it by now."""
        if self.state.status in ("pending", "approved") and self.expires <= now():
            self.state.status = "expired"
        return self.state.status


class Approvals:
    """Every question that is open, and those decided lately."""

    def __init__(
        self,
        settings: Settings,
        visibility: Visibility,
        audit: Audit,
        place: Callable[[Session, Request], object],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._settings = settings
        self._visibility = visibility
        self._audit = audit
        self._place = place
        """Refuses a request for which its session has no place."""
        self._loop = loop
        self._known: dict[str, _Asked] = {}
        self._tokens: dict[str, frozenset[str]] = {}
        """Paths that the steps of a running, approved plan may command."""
        self.on_change: list[Callable[[], None]] = []
        """Called when the list may have changed."""

    def _changed(self) -> None:
        for changed in self.on_change:
            changed()

    # -- what commands ask ---------------------------------------------------------------------

    @staticmethod
    def wanted(session: Session, entry: Entry, value: Any) -> bool:
        """Tell whether a command wants approval; bringing an actuator to rest never does."""
        if not session.rights.asks(entry.path):
            return False
        return entry.kind is not Kind.ACTUATOR or value is None or value != safe_value(entry)

    def check(self, session: Session, request: Request, entry: Entry, value: Any) -> None:
        """Refuse a command that a person has to approve and has not.

        Called when nothing else is in its way: it uses the approval that the request names up.

        :raises ApprovalRequired: with the id to ask about and to repeat the command with.
        :raises Forbidden: it was rejected, used, or is not for this.
        """
        if not self.wanted(session, entry, value):
            return
        covered = self._tokens.get(request.approval or "")
        if covered is not None and entry.path in covered:
            return
        self.demand(session, request, entry, value, About((entry.path,), (entry.path,)))

    def demand(
        self, session: Session, request: Request, entry: Entry, value: Any, about: About
    ) -> None:
        """Use an approval of a command up, or ask for one.

        :raises ApprovalRequired, Forbidden: as `check` does.
        """
        digest = _digest(session.principal, request.type, entry.path, value)
        if request.approval is not None:
            self._use(session, request, request.approval, digest, entry.path)
            return
        asked = self._same(session, digest) or self._ask(
            session, request, entry, value, about, digest
        )
        state = asked.state
        if asked.status == "rejected":
            raise _rejected(state)
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

    def _same(self, session: Session, digest: bytes) -> _Asked | None:
        mine = (a for a in self._known.values() if a.asker == session.principal.identity)
        return next(
            (
                a
                for a in mine
                if a.digest == digest
                and a.status in ("pending", "approved", "rejected")
                and a.expires > now()
            ),
            None,
        )

    def _ask(
        self,
        session: Session,
        request: Request,
        entry: Entry,
        value: Any,
        about: About,
        digest: bytes,
    ) -> _Asked:
        self._room(session.principal)
        moment = now()
        expires = moment + int(self._settings.config.safety.approval_ttl * 1e9)
        state = ApprovalState(
            approval=ID + secrets.token_hex(8),
            request="write" if request.type == "write" else "execute",
            path=entry.path,
            principal=session.principal.name,
            asked=iso(moment),
            expires=iso(expires),
            value=_shown(value),
            steps=about.steps,
        )
        tenants = frozenset(tenant_of(path) or "" for path in about.paths)
        asked = _Asked(state, session.principal.identity, about.seen, tenants, expires, digest)
        self._known[state.approval] = asked
        self._loop.call_later(self._settings.config.safety.approval_ttl + 0.01, self._changed)
        self._changed()
        return asked

    def _room(self, principal: Principal) -> None:
        """Make room for one more question: what is over goes first.

        :raises QueueFull: too many wait for an answer.
        """
        moment = now()
        mine = [a for a in self._known.values() if a.asker == principal.identity]
        if sum(a.status == "pending" for a in mine) >= _EACH:
            raise QueueFull(
                f"{principal.name} already has {_EACH} commands waiting for approval",
                remedy="Wait until they are decided or expire.",
            )
        if len(self._known) >= _ALL:
            self._drop()
        for over in [a for a in mine if a.expires <= moment][:-_EACH]:
            del self._known[over.state.approval]

    def _drop(self) -> None:
        """Let the oldest question go: one that is over, or of the tenants that ask most."""
        moment = now()
        counts = Counter(asked.tenants for asked in self._known.values())
        most = max(counts, key=lambda tenants: counts[tenants])
        every = self._known.items()
        over = next((id_ for id_, a in every if a.expires <= moment), None)
        del self._known[over or next(id_ for id_, a in every if a.tenants == most)]

    def _use(self, session: Session, request: Request, id_: str, digest: bytes, path: str) -> None:
        asked = self._known.get(id_)
        if asked is None or asked.asker != session.principal.identity or asked.digest != digest:
            raise Forbidden(
                "the approval is for a different command, value or principal",
                path=path,
                remedy="Send the command without `approval` to request a new one.",
            )
        if asked.status == "rejected":
            raise _rejected(asked.state)
        if asked.status == "pending":
            raise ApprovalRequired(
                f"`{asked.state.request} {path}` is not approved yet",
                path=path,
                remedy=f"Wait until {PATH} shows it as approved, then send the same command again.",
                details={"approval": id_, "expires": asked.state.expires},
            )
        if asked.status != "approved":
            raise Forbidden(
                f"the approval is {asked.status}; an approval is valid for one command, until "
                "it expires",
                path=path,
                remedy="Send the command without `approval` to request a new one.",
            )
        self._place(session, request)  # or it would be used up for nothing
        asked.state.status = "used"
        self._changed()

    # -- plans ---------------------------------------------------------------------------------

    def open(self, paths: tuple[str, ...]) -> str:
        """Return what lets the steps of an approved plan pass, until `close`."""
        token = "plan-" + secrets.token_hex(16)
        self._tokens[token] = frozenset(paths)
        return token

    def close(self, token: str | None) -> None:
        """Have nothing pass by a token any more."""
        self._tokens.pop(token or "", None)

    # -- who decides ---------------------------------------------------------------------------

    def request(
        self, session: Session, asked: ApprovalRequest, *, dry_run: bool
    ) -> ApprovalState | None:
        """Decide as somebody else than who asked.

        :raises UnknownPath: there is no such question for this principal.
        :raises Forbidden: it may not decide, or there is nothing to decide any more.
        """
        found = self._found(session, asked.id)
        if session.principal.identity == found.asker:
            raise Forbidden(
                "you cannot approve your own command",
                path=PATH,
                remedy="Ask someone else whose role has `may_approve = true`.",
            )
        if not self._may(session, found):
            raise _may_not(session)
        self._check_open(found)
        if dry_run:
            return None
        return self._decide(session, found, asked.decision, asked.reason, at="gateway")

    def answer(
        self, session: Session, id_: str, decision: Decision, reason: str | None
    ) -> ApprovalState:
        """Decide as the person who sits at the client of a session: see `ClientApi.approve`.

        :raises UnknownPath, Forbidden: as `request` does; its own needs a role with `approve_own`.
        """
        found = self._found(session, id_)
        own = session.principal.identity == found.asker
        rights = session.rights
        if own and decision == "approve" and not all(map(rights.may_approve_own, found.tenants)):
            raise Forbidden(
                f"{session.principal.name} may not approve its own commands",
                path=PATH,
                remedy="Ask someone else whose role has `may_approve = true`.",
            )
        if not own and not self._may(session, found):
            raise _may_not(session)
        self._check_open(found)
        return self._decide(session, found, decision, reason, at="client")

    def _found(self, session: Session, id_: str) -> _Asked:
        found = self._known.get(id_)
        if found is None or not self._sees(session, found):
            raise UnknownPath(f"there is no approval '{id_[:64]}'", remedy=f"Read {PATH}.")
        return found

    def _may(self, session: Session, asked: _Asked) -> bool:
        rights = session.rights
        sees_all = self._visibility.sees_all
        return all(map(rights.may_approve, asked.tenants)) and sees_all(rights, asked.seen)

    def _sees(self, session: Session, asked: _Asked) -> bool:
        return session.principal.identity == asked.asker or self._may(session, asked)

    @staticmethod
    def _check_open(asked: _Asked) -> None:
        if asked.status != "pending":
            raise Forbidden(
                f"the approval is already {asked.status}",
                path=PATH,
                remedy="Send the command again to request a new approval.",
            )

    def _decide(
        self, session: Session, asked: _Asked, decision: Decision, reason: str | None, *, at: str
    ) -> ApprovalState:
        state = asked.state
        state.status = "approved" if decision == "approve" else "rejected"
        state.by, state.reason = session.principal.name, reason
        plan = bool(state.steps)
        shown: Any = bounded(state.value)
        self._audit.note(
            "approval",
            principal=session.principal,
            session=session,
            tenant=min(asked.tenants) or None,
            path=state.path,
            touches=asked.seen if plan else None,
            outcome=state.status,
            approval=state.approval,
            asker=state.principal,
            request=state.request,
            # The values of a plan are told with the requests of its steps.
            value=hashed(msgspec.json.encode(shown)) if plan else shown,
            steps=list(state.steps) or None,
            reason=reason,
            at=at,
        )
        self._changed()
        return msgspec.structs.replace(state)

    def view(self, session: Session) -> list[dict[str, Any]]:
        """List what a session may decide on, or has asked for; newest first."""
        shown = [a for a in reversed(self._known.values()) if self._sees(session, a) and a.status]
        return [to_plain(a.state) for a in shown]


def _digest(principal: Principal, type_: str, path: str, value: Any) -> bytes:
    who, proof = principal.identity
    data = msgspec.msgpack.encode([who, proof, type_, path, to_plain(value)], order="sorted")
    return hashlib.sha256(data).digest()


def _shown(value: Any) -> Any:
    plain = to_plain(value)
    size = len(dump(plain, Encoding.JSON))
    return plain if size <= _SHOWN else {"omitted": size}


def _rejected(state: ApprovalState) -> RcpError:
    why = f": {state.reason}" if state.reason else ""
    return Forbidden(
        f"{state.by} rejected `{state.request} {state.path}`{why}",
        path=state.path,
        remedy=f"Do not repeat the command; approval can be requested again after {state.expires}.",
        details={"approval": state.approval, "expires": state.expires},
    )


def _may_not(session: Session) -> Forbidden:
    return Forbidden(
        f"{session.principal.name} may not approve commands on these paths",
        path=PATH,
        remedy="Ask someone whose role has `may_approve = true`.",
    )
