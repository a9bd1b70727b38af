"""`/system/leases`: acquire, renew, release and hand over, as requests of a session."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator
from typing import Annotated, Any, Literal
from weakref import WeakValueDictionary

import msgspec
from msgspec import Meta

from rcp_kernel.clock import iso
from rcp_kernel.contract.identity import same
from rcp_kernel.errors import (
    AdapterUnavailable,
    BadRequest,
    Forbidden,
    LeaseHeld,
    LeaseLost,
    LeaseRequired,
    OutOfRange,
    RcpError,
    UnknownPath,
)
from rcp_kernel.features import FeatureHost, Scope
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import RobotLease
from rcp_kernel.tree.entry import RobotUnit
from rcp_kernel.types import Time
from rcp_kernel.values import value_type
from rcp_kernel.wire import Request
from rcp_leases.lease import GatewayLease, Lease, Program
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
    program: Annotated[str, Meta(max_length=64)] | None = None
    """For hubs: which of the person's programs asks."""
    former: Annotated[str, Meta(max_length=64)] | None = None
    """For hubs: what that program was called at the hub where it was before."""


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
        self._turns = WeakValueDictionary[tuple[str, str], asyncio.Lock]()

    def view(self, session: Session) -> Iterator[dict[str, Any] | None]:
        """List the leases on robots visible to a session, in steps."""
        look = self._host.scopes.look
        for lease in list(self._leases.by_id.values()):
            visible = yield from look(session.rights, lease.scope)
            yield msgspec.to_builtins(_state(lease)) if visible else None
        for there in list(self._leases.gateways.others()):
            visible = yield from look(session.rights, Scope(there.scope))
            yield msgspec.to_builtins(_state_there(there)) if visible else None

    def request(
        self, session: Session, request: LeaseRequest, *, dry_run: bool
    ) -> LeaseState | Coroutine[Any, Any, LeaseState] | None:
        """Carry out a request and return the resulting lease; None for a dry run.

        A coroutine returns it when the robots' own gateways have answered, if they have any.

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
            return None if dry_run else self._hand_over(session, lease, heir)
        if request.do == "renew":
            ttl, program = self._ttl(request), self._program(session, request)
            return None if dry_run else self._renew(session, lease, ttl, program)
        return None if dry_run else self._release(session, lease)

    def _acquire(
        self, session: Session, request: LeaseRequest, scope: Scope, *, dry_run: bool
    ) -> LeaseState | Coroutine[Any, Any, LeaseState] | None:
        scopes, rights, leases = self._host.scopes, session.rights, self._leases
        ttl, take = self._ttl(request), request.take
        if not scopes.sees(rights, scope):
            raise UnknownPath(f"no resources in {scope.text}", path=scope.text)
        if not scopes.may(rights, scope, COMMANDING):
            raise Forbidden(
                f"{session.principal.name} may not command anything in {scope.text}",
                path=scope.text,
            )
        if self._host.closing:
            raise AdapterUnavailable("the gateway is closing")
        units = leases.gateways.units(scope)
        program = self._program(session, request)
        if dry_run or units:
            leases.check_free(session, scope, request.reason, take=take, program=program)
        if dry_run:
            return None
        if units:
            return self._acquire_there(session, request, scope, ttl, units)
        return _state(
            leases.acquire(
                session, scope, self._until(ttl), request.reason, take=take, program=program
            )
        )

    def _program(self, session: Session, request: LeaseRequest) -> Program | None:
        """Return the program of a person who came by a hub, if the hub has said it."""
        if session.principal.via is None or request.program is None:
            return None
        return Program(request.program, request.former).of_person(session)

    def _renew(
        self, session: Session, lease: Lease, ttl: float, program: Program | None
    ) -> LeaseState | Coroutine[Any, Any, LeaseState]:
        units = self._leases.gateways.units(lease.scope)
        if units:
            return self._renew_there(session, lease, ttl, units)
        if program is not None:
            lease.program = program.name
        self._leases.renew(session, lease, self._until(ttl))
        return _state(lease)

    def _release(
        self, session: Session, lease: Lease
    ) -> LeaseState | Coroutine[Any, Any, LeaseState]:
        self._leases.release(session, lease)
        return self._release_there(session, lease) if lease.gateways else _state(lease)

    def _hand_over(
        self, session: Session, lease: Lease, heir: Session
    ) -> LeaseState | Coroutine[Any, Any, LeaseState]:
        if lease.gateways and not same(session.principal, heir.principal):
            return self._hand_over_there(session, lease, heir)
        self._leases.hand_over(session, lease, heir)
        return _state(lease)

    # -- robots with gateways of their own -----------------------------------------------------

    def _turn(self, session: Session) -> asyncio.Lock:
        """Return what keeps the requests of a person in order: at a robot they are one holder."""
        key = session.principal.identity
        lock = self._turns.get(key)
        if lock is None:
            lock = self._turns[key] = asyncio.Lock()
        return lock

    async def _acquire_there(
        self,
        session: Session,
        request: LeaseRequest,
        scope: Scope,
        ttl: float,
        units: list[RobotUnit],
    ) -> LeaseState:
        leases, until, take = self._leases, self._until(ttl), request.take
        async with self._turn(session):
            granted = await leases.gateways.acquire(
                units,
                scope,
                ttl,
                take=take,
                reason=request.reason,
                principal=session.principal.name,
                program=Program.of(session),
            )
            try:
                if not self._host.sessions.holding(session.holder):
                    raise LeaseLost("the session ended meanwhile", path=scope.text)
                lease = leases.acquire(
                    session, scope, until, request.reason, take=take, granted=granted
                )
            except RcpError:  # another session here was faster
                await leases.gateways.release(units, _unheld(scope, granted.held))
                raise
            leases.compare(lease)
            return self._still(session, lease)

    async def _renew_there(
        self, session: Session, lease: Lease, ttl: float, units: list[RobotUnit]
    ) -> LeaseState:
        leases, until = self._leases, self._until(ttl)
        async with self._turn(session):
            self._still(session, lease)
            with leases.consulting_gateways(lease):
                try:
                    granted = await leases.gateways.extend(units, lease, ttl, Program.of(session))
                except (LeaseHeld, LeaseLost, LeaseRequired) as error:
                    by = (error.details or {}).get("holder") or (error.details or {}).get("by")
                    leases.revoke(lease, by or "its own gateway", error.message)
                    return self._still(session, lease)
                self._still(session, lease)
                leases.renew(session, lease, until, granted)
            return self._still(session, lease)

    async def _release_there(self, session: Session, lease: Lease) -> LeaseState:
        async with self._turn(session):
            await self._leases.gateways.release(self._leases.gateways.units(lease.scope), lease)
        return _state(lease)

    async def _hand_over_there(self, session: Session, lease: Lease, heir: Session) -> LeaseState:
        leases = self._leases
        units = leases.gateways.units(lease.scope)
        async with self._turn(session):
            self._still(session, lease)
            with leases.consulting_gateways(lease):
                try:
                    granted = await leases.gateways.hand_over(units, lease, heir.principal)
                except BaseException as error:  # some may have a new holder
                    leases.revoke(lease, session.principal.name, f"its hand-over failed: {error}")
                    raise
                self._still(session, lease)
                leases.hand_over(session, lease, heir, granted)
        return _state(lease)

    def _still(self, session: Session, lease: Lease) -> LeaseState:
        """Return a lease that the session still holds.

        :raises LeaseLost: it does not.
        """
        return _state(self._leases.find(session, lease.id, None))

    def _until(self, ttl: float) -> int:
        return self._host.clock.now() + int(ttl * 1e9)

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


def _unheld(scope: Scope, held: dict[str, GatewayLease]) -> Lease:
    """Return a lease that robots' gateways have granted and this one has not."""
    return Lease("", scope, "", "", None, 0, 0, 0, gateways=held)


def _state_there(lease: RobotLease) -> LeaseState:
    """Describe a lease of a robot's own gateway."""
    return LeaseState(
        lease=lease.id,
        scope=lease.scope,
        holder=lease.holder,
        session=None,
        priority=lease.priority,
        since=iso(lease.since),
        expires=iso(lease.expires),
        reason=lease.reason,
    )


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
