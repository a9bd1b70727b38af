"""Leases: exclusive control of a sub-tree for a limited time, by priority.

While a lease is held, writes and executes of other sessions in its scope are refused, even those
admitted before the lease was acquired. When a holder loses a lease, its commands and writes in the
scope are cancelled, and whatever they kept in motion is brought to rest.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import structlog

from rcp_kernel.clock import iso
from rcp_kernel.errors import BadRequest, LeaseLost, LeaseRequired, RcpError
from rcp_kernel.features import Call, FeatureHost, Guard, Scope, Slot
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_leases.config import LeasesConfig
from rcp_leases.gateways import GatewayLeases, Granted
from rcp_leases.lease import GatewayLease, Lease, Program, refusal
from rcp_leases.losses import Loss, Losses
from rcp_scheduling.turns import Work

__all__ = ["COMMANDING", "Leases"]

log = structlog.get_logger("rcp.leases")
COMMANDING = Operation.WRITE | Operation.EXECUTE
_TABLE = "held"
_NEEDED = 100_000  # cached paths


class Leases(Guard):
    """All leases of the gateway: the guard that checks each write and execute against them."""

    slot = Slot.LEASE

    def __init__(
        self, config: LeasesConfig, host: FeatureHost, *, changed: Callable[[], None]
    ) -> None:
        """Start without leases; `changed` is called after every change."""
        self._host = host
        self._now = host.clock.now
        self._changed = changed
        self._store = host.store(_TABLE)
        self.by_id: dict[str, Lease] = {}
        """By id."""
        self.gateways = GatewayLeases(host.robots, host.clock, self.by_id)
        """The leases that the robots' own gateways hold."""
        self._asked: set[str] = set()
        """Ids of the leases about which robots' gateways are being asked."""
        host.robots.follow_leases(self._gateway_reported)
        self._lost = Losses()
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._over: dict[str, Lease | None] = {}
        """Cache of `over`; cleared on every change."""
        self._needed: dict[str, bool] = {}
        """Cache of `_requires`."""
        self._required: tuple[Pattern, ...] = ()
        self.idle = True
        """Whether there is nothing to check; false from the moment at which there is a lease."""
        self.configure(config)

    def configure(self, config: LeasesConfig) -> None:
        """Apply the settings of a configuration."""
        self.config = config
        self._required = tuple(
            Pattern(text if text.startswith("/tenant/") else f"/tenant/*{text}")
            for text in config.required
        )
        self._needed.clear()
        self._refresh()

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Restore the leases of the previous run; those held at exit are restored by the next run."""
        self._restore()
        try:
            yield
        finally:
            for timer in self._timers.values():
                timer.cancel()

    def _refresh(self) -> None:
        self._over.clear()
        self.idle = not (self.by_id or self._lost or self._required)

    def _restore(self) -> None:
        for id_, kept in self._store.load().items():
            try:
                gateways = {
                    name: GatewayLease(*one) for name, one in kept.pop("gateways", {}).items()
                }
                lease = Lease(id_, Scope(kept.pop("scope")), **kept, gateways=gateways)
            except (RcpError, TypeError, KeyError, AttributeError) as error:
                log.warning(
                    "store_row_unreadable", table=f"leases.{_TABLE}", key=id_, error=str(error)
                )
                continue
            self.by_id[id_] = lease
            # The clock may have been set back: none lasts longer than one that is acquired now.
            most = self._now() + int(self.config.ttl_max * 1e9)
            if lease.expires > most:
                lease.expires = most
                self._store.put(id_, lease.kept())  # or the next start would give it that again
            if lease.left(self._now()):
                self._set_timer(lease)
            else:
                self._expire(lease)
        self._refresh()

    # -- checking commands ---------------------------------------------------------------------

    def admit(self, call: Call) -> None:
        """Check the leases of a path.

        :raises LeaseHeld, LeaseLost, LeaseRequired: see `check`.
        """
        self.check(call.session, call.entry)

    def confirm(self, call: Call) -> None:
        """Repeat the check of `admit`: leases may have changed since."""
        self.check(call.session, call.entry)

    def check(self, session: Session, entry: Entry) -> None:
        """Check that the session may command a resource.

        :raises LeaseHeld: another session holds a lease on it.
        :raises LeaseLost: the session lost its lease and has not acquired one since.
        :raises LeaseRequired: the path requires a lease.
        """
        if self.idle or entry.tenant is None:
            return
        path, holders = entry.path, session.holders
        lease = self.over(path)
        if lease is not None and lease.key in holders:
            return
        for loss in self._lost.of(holders):
            if loss.scope.covers(path):
                details = {"lease": loss.lease, "scope": loss.scope.text, "by": loss.by}
                details["reason"] = loss.reason
                raise LeaseLost(loss.message, path=path, details=details)
        if lease is not None:
            raise refusal(lease, path, self._now())
        if self._requires(path):
            raise LeaseRequired(f"{path} accepts commands only under a lease", path=path)

    def over(self, path: str) -> Lease | None:
        """Return the lease that covers a path."""
        try:
            lease = self._over[path]
        except KeyError:
            covering = [held for held in self.by_id.values() if held.scope.covers(path)]
            lease = self._over[path] = max(covering, key=lambda held: held.expires, default=None)
        if lease is None or lease.expires > self._now():
            return lease
        if self._host.closing:
            return None
        self._expire(lease)  # its timer is slightly late
        return self.over(path)

    def _requires(self, path: str) -> bool:
        if not self._required:
            return False
        needed = self._needed.get(path)
        if needed is None:
            if len(self._needed) > _NEEDED:
                self._needed.clear()
            needed = self._needed[path] = any(p.matches(path) for p in self._required)
        return needed

    # -- requests of holders -------------------------------------------------------------------

    def acquire(
        self,
        session: Session,
        scope: Scope,
        until: int,
        reason: str | None,
        *,
        take: bool,
        granted: Granted | None = None,
        program: Program | None = None,
    ) -> Lease:
        """Grant a session the lease on a scope that it may command, or renew the one it holds.

        `until` is when it ends, ns; `granted` is what robots' own gateways have said.

        :raises LeaseHeld: another session holds an overlapping lease and is not pre-empted.
        :raises BadRequest: a take-over has no reason.
        """
        self.check_free(session, scope, reason, take=take, program=program)
        by = session.principal.name
        for rival in self.rivals(session, scope, program):
            self.revoke(rival, by, reason or "")
        priority = session.rights.priority(scope.tenant)
        lease = self.own(session, scope) or self._followed(session, scope, program)
        if lease is None:
            lease = Lease(
                id=_new_id(),
                scope=scope,
                key=session.holder,
                holder=by,
                session=None if session.holder != session.id else session.id[:8],
                priority=priority,
                since=self._now(),
                expires=0,
                reason=reason,
            )
            self.by_id[lease.id] = lease
        lease.priority = priority
        lease.program = None if program is None else program.name
        for key in session.holders:
            self._lost.clear(key, scope)
        self._extend(session, lease, until, granted)
        self._note("acquire", lease, session, take=take, reason=reason)
        return lease

    def _followed(self, session: Session, scope: Scope, program: Program | None) -> Lease | None:
        """Return the lease that a person's program has acquired by another hub, now its own here.

        It gets another id, so that the other hub learns that its own is over.
        """
        for lease in self.by_id.values():
            if lease.scope.text == scope.text and _is_of(lease, program):
                self._remove(lease)
                self._host.control.hand_over(lease.key, scope.covers, session)
                lease.id, lease.key = _new_id(), session.holder
                self.by_id[lease.id] = lease
                return lease
        return None

    def check_free(
        self,
        session: Session,
        scope: Scope,
        reason: str | None,
        *,
        take: bool,
        program: Program | None = None,
    ) -> None:
        """Check that a session could acquire the lease on a scope.

        :raises LeaseHeld, BadRequest: as `acquire` does.
        """
        if take and not reason:
            raise BadRequest(
                "`take` needs a `reason`", remedy="Set `reason`; the previous holder is shown it."
            )
        priority = session.rights.priority(scope.tenant)
        for rival in self.rivals(session, scope, program):
            if not take or priority <= rival.priority:
                of = self._visible_scope(session, rival, scope)
                raise refusal(rival, scope.text, self._now(), of=of)

    def _visible_scope(self, session: Session, rival: Lease, scope: Scope) -> str:
        """Return the scope of a rival's lease, or the requested one if the rival's is hidden."""
        visible = self._host.scopes.sees(session.rights, rival.scope)
        return rival.scope.text if visible else scope.text

    def rivals(self, session: Session, scope: Scope, program: Program | None = None) -> list[Lease]:
        """List the leases of other sessions, and other programs, that overlap a scope."""
        for lease in [held for held in self.by_id.values() if held.expires <= self._now()]:
            self._expire(lease)
        others = (
            lease
            for lease in self.by_id.values()
            if lease.key != session.holder and not _is_of(lease, program)
        )
        return [lease for lease in others if lease.scope.overlaps(scope)]

    def own(self, session: Session, scope: Scope) -> Lease | None:
        """Return the session's lease on exactly this scope."""
        own = [held for key in session.holders for held in self.by_id.values() if held.key == key]
        return next((held for held in own if held.scope.text == scope.text), None)

    def find(self, session: Session, id_: str | None, scope: Scope | None) -> Lease:
        """Return a lease of the session, by its id or its scope.

        :raises LeaseLost: the session has lost it.
        :raises LeaseRequired: the session never held it.
        """
        if id_ is not None:
            lease = self.by_id.get(id_)
            if lease is not None and lease.key in session.holders:
                return lease
        elif scope is not None and (lease := self.own(session, scope)) is not None:
            return lease
        for loss in self._lost.of(session.holders):
            if loss.lease == id_ or (scope is not None and loss.scope.text == scope.text):
                raise LeaseLost(loss.message, details={"by": loss.by, "reason": loss.reason})
        what = id_ if scope is None else scope.text
        raise LeaseRequired(f"this session holds no lease {what}")

    def renew(
        self, session: Session, lease: Lease, until: int, granted: Granted | None = None
    ) -> None:
        """Extend a lease, as robots' own gateways have if there are any in its scope."""
        lease.priority = session.rights.priority(lease.scope.tenant)
        self._extend(session, lease, until, granted)

    def _extend(self, session: Session, lease: Lease, until: int, granted: Granted | None) -> None:
        lease.expires = until
        if granted is not None:
            lease.gateways |= granted.held
            lease.expires = min(until, granted.until)
        if session.principal.expires is not None:
            lease.expires = min(lease.expires, session.principal.expires)
        self._set_timer(lease)
        self._keep(lease)

    def release(self, session: Session, lease: Lease) -> None:
        """Release a lease; running commands continue."""
        self._remove(lease)
        self._note("release", lease, session)

    def forgive(self, session: Session, id_: str | None, scope: Scope | None) -> None:
        """Forget losses of a session, so that it can command there without a lease again."""
        for key in session.holders:
            for loss in self._lost.of((key,)):
                if loss.lease == id_ or (scope is not None and loss.scope.overlaps(scope)):
                    self._lost.clear(key, loss.scope)
        self._refresh()

    def hand_over(
        self, session: Session, lease: Lease, heir: Session, granted: Granted | None = None
    ) -> None:
        """Transfer a lease, and the commands running under it, to another session."""
        before = lease.key
        if granted is not None:
            lease.gateways |= granted.held
            lease.expires = min(lease.expires, granted.until)
            self._set_timer(lease)
        self._host.control.hand_over(before, lease.scope.covers, heir)
        lease.key = heir.holder
        lease.holder = heir.principal.name
        lease.session = None if heir.holder != heir.id else heir.id[:8]
        lease.priority = heir.rights.priority(lease.scope.tenant)
        if heir.principal.expires is not None:
            lease.expires = min(lease.expires, heir.principal.expires)
            self._set_timer(lease)
        self._lost.clear(lease.key, lease.scope)
        self._keep(lease)
        facts = {"lease": lease.id, "scope": lease.scope.text, "by": session.principal.name}
        tell = self._host.sessions.tell
        tell(lease.key, "lease_given", **facts, to=lease.holder, expires=iso(lease.expires))
        if before != lease.key:
            tell(before, "lease_given", **facts, to=lease.holder)
        self._note("hand_over", lease, session, to=lease.holder)

    # -- expiry and loss -----------------------------------------------------------------------

    def revoke(
        self, lease: Lease, by: str, reason: str, *, stop: bool = True, ends: bool = True
    ) -> None:
        """Revoke a lease and cancel the commands that its holder gave under it.

        `stop` brings the robots to rest; pass False if they are being halted anyway. Without `ends`,
        nothing ends but the lease.
        """
        if lease.id not in self.by_id:
            return
        self._remove(lease)
        loss = Loss(lease.id, lease.scope, by, reason)
        self._lost.add(lease.key, loss)
        self._refresh()
        covers = self._revoked_paths(lease)
        control, scope = self._host.control, lease.scope
        if ends:
            control.withdraw(lease.key, covers, lambda path: LeaseLost(loss.message, path=path))
        if ends and stop:
            entries = self._host.scopes.entries(scope)
            control.bring_to_rest(entry for entry in entries if covers(entry.path))
        facts = {"lease": lease.id, "scope": scope.text, "by": by, "reason": reason}
        self._host.sessions.tell(lease.key, "lease_lost", **facts)
        self._note("lost", lease, None, by=by, reason=reason)

    def _revoked_paths(self, lost: Lease) -> Callable[[str], bool]:
        """Return a test for the paths that a holder no longer controls after losing a lease.

        Another lease of the same holder may still cover some of them.
        """
        covers, moment = lost.scope.covers, self._now()
        others = [
            other.scope.covers
            for other in self.by_id.values()
            if other.key == lost.key and other.expires > moment and other.scope.overlaps(lost.scope)
        ]
        if not others:
            return covers
        return lambda path: covers(path) and not any(still(path) for still in others)

    def _expire(self, lease: Lease) -> None:
        if not self._host.closing:  # otherwise the next run restores it
            self.revoke(lease, "the gateway", "the lease expired")

    def drop_on(self, paths: frozenset[str], by: str, reason: str) -> None:
        """Revoke the leases that cover any of these paths, whose robots are being halted."""
        for lease in list(self.by_id.values()):
            if any(map(lease.scope.covers, paths)):
                self.revoke(lease, by, reason, stop=False)

    def session_ended(self, session: Session) -> None:
        """Revoke the leases of an ended session, unless the gateway is stopping.

        One of a person who came by a hub expires: the person may come by another one.
        """
        if self._host.closing or session.principal.via is not None:
            return
        for lease in [held for held in self.by_id.values() if held.key == session.holder]:
            self.revoke(lease, "the gateway", "its session ended")

    def review(self) -> None:
        """Revoke the leases in whose scope the holder may no longer command anything."""
        for lease in list(self.by_id.values()):
            self._host.in_steps(self._review(lease))

    def _review(self, lease: Lease) -> Work:
        key, look = lease.key, self._host.scopes.look
        holders = self._host.sessions.holding(key)
        for session in holders:
            if (yield from look(session.rights, lease.scope, COMMANDING)):
                return
        if holders and lease.key == key:
            self.revoke(lease, "the gateway", "the holder no longer has access")

    # -- robots with gateways of their own -----------------------------------------------------

    @contextmanager
    def consulting_gateways(self, lease: Lease) -> Generator[None]:
        """Compare a lease with those at robots' gateways only once they have all answered."""
        self._asked.add(lease.id)
        try:
            yield
        finally:
            self._asked.discard(lease.id)
            self.compare(lease)

    def _gateway_reported(self, unit: RobotUnit) -> None:
        changed = self.gateways.update(unit)
        for lease in list(self.by_id.values()):
            self._compare(lease, unit)
        if changed:
            self._changed()

    def compare(self, lease: Lease) -> None:
        """Revoke a lease that a robot's own gateway has ended or given to somebody else."""
        for unit in self.gateways.units(lease.scope):
            self._compare(lease, unit)

    def _compare(self, lease: Lease, unit: RobotUnit) -> None:
        held, own = lease.gateways.get(unit.name), unit.own_leases
        if held is None or own is None or own.reported < held.reported or lease.id in self._asked:
            return
        there = next((one for one in own.leases if one.id == held.id), None)
        if there is not None and there.holder == lease.holder:
            return
        others = (one for one in own.leases if Scope(one.scope).overlaps(lease.scope))
        taker = next((one.holder for one in others), "its own gateway")
        # A person who goes on at another hub has taken along what runs; from anybody else, the
        # robot's gateway has taken it.
        self.revoke(lease, taker, f"{unit.name} is no longer under it", ends=taker != lease.holder)

    # -- bookkeeping ---------------------------------------------------------------------------

    def _set_timer(self, lease: Lease) -> None:
        if (timer := self._timers.pop(lease.id, None)) is not None:
            timer.cancel()
        left = lease.left(self._now())
        self._timers[lease.id] = self._host.loop.call_later(left, self._expire, lease)

    def _keep(self, lease: Lease) -> None:
        self._store.put(lease.id, lease.kept())
        self._refresh()
        self._changed()

    def _remove(self, lease: Lease) -> None:
        del self.by_id[lease.id]
        if (timer := self._timers.pop(lease.id, None)) is not None:
            timer.cancel()
        self._store.put(lease.id, None)
        self._refresh()
        self._changed()

    def _note(self, did: str, lease: Lease, session: Session | None, **facts: Any) -> None:
        self._host.note(
            "lease",
            principal=None if session is None else session.principal,
            tenant=lease.scope.tenant,
            path=lease.scope.text,
            session=session,
            did=did,
            lease=lease.id,
            holder=lease.holder,
            **facts,
        )


def _is_of(lease: Lease, program: Program | None) -> bool:
    return program is not None and lease.program is not None and lease.program in program


def _new_id() -> str:
    return "l-" + secrets.token_hex(8)
