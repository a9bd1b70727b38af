"""`/system/leases`: acquire, renew, release and hand over, as requests of a session."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.clock import iso
from rcp_kernel.errors import (
    AdapterUnavailable,
    BadRequest,
    Forbidden,
    LeaseLost,
    OutOfRange,
    RcpError,
    UnknownPath,
)
from rcp_kernel.features import FeatureHost, Scope
from rcp_kernel.sessions.session import Session
from rcp_kernel.types import Time
from rcp_kernel.values import value_type
from rcp_kernel.wire import Request
from rcp_leases.lease import Lease
from rcp_leases.leases import COMMANDING, Leases

__all__ = ["PATH", "LeaseRequest", "LeaseRequests", "LeaseState", "releases"]

PATH = "/system/leases"
_RELEASE = 2048  # bytes of a release at most


class LeaseRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An operation on a lease, identified by its scope or its id."""

    do: Literal["acquire", "renew", "release", "hand_over"]
    scope: Annotated[str, Meta(max_length=512)] | None = None
    """`/tenant/<tenant>`, a sub-tree of a branch (`/actuator`), or a robot of a tenant."""
    lease: Annotated[str, Meta(max_length=64)] | None = None
    """The id returned by `acquire`, instead of the scope."""
    ttl: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})] | None = None
    """Seconds until it expires unless renewed; by default the gateway's setting."""
    take: bool = False
    """Take it over from holders of lower priority; requires a `reason`."""
    to: Annotated[str, Meta(max_length=128)] | None = None
    """The recipient of a hand-over: a principal's name, or the beginning of a session's id."""
    reason: Annotated[str, Meta(max_length=500)] | None = None


class LeaseState(msgspec.Struct, frozen=True):
    """A lease."""

    lease: str
    scope: str
    holder: str
    """The principal who holds it."""
    session: str | None
    """The beginning of the holding session's id; None for a holder without connections."""
    priority: int
    since: Time
    expires: Time
    reason: str | None = None


class _Asked(msgspec.Struct, frozen=True):
    """The part of a request that shows whether it is a release."""

    do: str


_ASKED = value_type(_Asked)


def releases(request: Request) -> bool:
    """Return whether a request only releases a lease."""
    if len(bytes(request.body)) > _RELEASE:
        return False
    try:
        return request.decode_body(_ASKED, "release").do == "release"
    except RcpError:
        return False


class LeaseRequests:
    """Lists the leases and carries out requests."""

    def __init__(self, leases: Leases, host: FeatureHost) -> None:
        self._leases = leases
        self._host = host

    def view(self, session: Session) -> Iterator[dict[str, Any] | None]:
        """List the leases on robots visible to a session, in steps."""
        look = self._host.scopes.look
        for lease in list(self._leases.held.values()):
            visible = yield from look(session.rights, lease.scope)
            yield msgspec.to_builtins(_state(lease)) if visible else None

    def request(
        self, session: Session, request: LeaseRequest, *, dry_run: bool
    ) -> LeaseState | None:
        """Carry out a request and return the resulting lease; None for a dry run.

        :raises LeaseHeld, LeaseLost, LeaseRequired, UnknownPath, Forbidden: it is refused.
        :raises BadRequest, OutOfRange: a field is missing, or exceeds its limit.
        """
        scope = None if request.scope is None else Scope(request.scope, session.tenant)
        if scope is None and (request.lease is None or request.do == "acquire"):
            raise BadRequest(
                "`scope` and `lease` are both missing", remedy="Set `scope` or `lease`."
            )
        if request.do == "acquire":
            assert scope is not None
            return self._acquire(session, request, scope, dry_run=dry_run)
        try:
            lease = self._leases.find(session, request.lease, scope)
        except LeaseLost:
            if request.do == "release" and not dry_run:
                self._leases.forgive(session, request.lease, scope)
            raise
        if request.do == "hand_over":
            heir = self._heir(session, request.to, lease.scope)
            if not dry_run:
                self._leases.hand_over(session, lease, heir)
        elif request.do == "renew":
            ttl = self._ttl(request)
            if not dry_run:
                self._leases.renew(session, lease, ttl)
        elif not dry_run:
            self._leases.release(session, lease)
        return None if dry_run else _state(lease)

    def _acquire(
        self, session: Session, request: LeaseRequest, scope: Scope, *, dry_run: bool
    ) -> LeaseState | None:
        scopes, rights = self._host.scopes, session.rights
        ttl = self._ttl(request)
        if not scopes.sees(rights, scope):
            raise UnknownPath(f"no resources in {scope.text}", path=scope.text)
        if not scopes.may(rights, scope, COMMANDING):
            raise Forbidden(
                f"{session.principal.name} may not command anything in {scope.text}",
                path=scope.text,
            )
        if self._host.closing:
            raise AdapterUnavailable("the gateway is closing")
        if dry_run:
            self._leases.check_free(session, scope, request.reason, take=request.take)
            return None
        return _state(self._leases.acquire(session, scope, ttl, request.reason, take=request.take))

    def _ttl(self, request: LeaseRequest) -> float:
        config = self._leases.config
        ttl = request.ttl if request.ttl is not None else config.ttl
        if ttl > config.ttl_max:
            raise OutOfRange(
                f"`ttl` is {ttl:g} s; the limit is {config.ttl_max:g} s",
                remedy="Use a shorter `ttl` and renew the lease in time.",
                details={"field": "ttl", "value": ttl, "maximum": config.ttl_max},
            )
        return ttl

    def _heir(self, session: Session, to: str | None, scope: Scope) -> Session:
        """Return the session to which a lease is handed over.

        :raises BadRequest: `to` is missing or ambiguous.
        :raises UnknownPath: no such principal may command in the scope.
        """
        if not to:
            raise BadRequest("`hand_over` needs `to`")
        sessions, may = self._host.sessions, self._host.scopes.may
        able = [
            s
            for s in sessions.everyone()
            if s is not session
            and to in (s.id[:8], s.principal.name)
            and may(s.rights, scope, COMMANDING)
        ]
        present = [s for s in able if not (s.stateless or s.one_way)]
        present = present or [sessions.commanding(s) for s in able]
        if not present:
            raise UnknownPath(
                f"no session of '{to[:64]}' may command {scope.text}",
                remedy="Set `to` to a principal or session of the same tenant; "
                "/system/sessions lists them.",
            )
        if len({s.holder for s in present}) > 1:
            raise BadRequest(
                f"{to[:64]} has {len(present)} sessions",
                remedy="Set `to` to the first characters of a session id: "
                + ", ".join(s.id[:8] for s in present[:10])
                + ".",
            )
        return present[0]


def _state(lease: Lease) -> LeaseState:
    return LeaseState(
        lease=lease.id,
        scope=lease.scope.text,
        holder=lease.holder,
        session=lease.session,
        priority=lease.priority,
        since=iso(lease.since),
        expires=iso(lease.expires),
        reason=lease.reason,
    )
