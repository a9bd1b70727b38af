"""Quotas: how much each tenant, and each principal by itself, may have of the gateway.

What an account holds is not counted up and down: its sessions are in a set, and what these hold is
summed when somebody wants more of it, so that no way out of a session can be forgotten.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from time import perf_counter
from typing import TYPE_CHECKING, Any

from rcp_kernel.access.acl import Rules
from rcp_kernel.access.token_bucket import NONE, SWEEP, Owner, QuotaUsage, TokenBucket
from rcp_kernel.config.limits import Quota
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import QueueFull
from rcp_kernel.sessions.backpressure import shed, waiting_bytes

if TYPE_CHECKING:
    from rcp_kernel.sessions.command import Command
    from rcp_kernel.sessions.session import Session

__all__ = ["QuotaTracker"]

_PLANS = "/system/plans"
_MANY = 10_000  # accounts, before idle ones are let go


class QuotaTracker:
    """The accounts of all tenants and principals that have a quota."""

    def __init__(
        self,
        settings: Settings,
        rules: Rules,
        loop: asyncio.AbstractEventLoop,
        sessions: Mapping[str, Session],
        running: Mapping[str, Command],
    ) -> None:
        self._settings = settings
        self._rules = rules
        self._loop = loop
        self._sessions = sessions
        """All that have a connection or wait for one, by id."""
        self._running = running
        """Commands, by id."""
        self._known: dict[tuple[Owner, Any], QuotaUsage[Session]] = {}
        self._charged: dict[str, tuple[QuotaUsage[Session], ...]] = {}
        self._timer: asyncio.TimerHandle | None = None

    # -- who has which quota -------------------------------------------------------------------

    def attach(self, session: Session) -> None:
        """Give a session its meter, or none if no quota concerns it."""
        config = self._settings.config
        accounts: list[QuotaUsage[Session]] = []
        principal = session.principal
        quota = self._quota_of(principal)
        if quota != NONE:
            accounts.append(self._account("principal", principal.identity, principal.name, quota))
        tenant = config.tenants.get(session.tenant or "")
        if tenant is not None and tenant.quota is not None:
            name = session.tenant or ""
            accounts.append(self._account("tenant", name, name, tenant.quota))
        known = session.token_bucket.accounts if session.token_bucket is not None else ()
        if known != tuple(accounts):
            session.token_bucket = TokenBucket(tuple(accounts)) if accounts else None

    def _account(self, owner: Owner, key: Any, name: str, quota: Quota) -> QuotaUsage[Session]:
        account = self._known.get((owner, key))
        if account is None:
            if len(self._known) >= _MANY:
                self._prune()
            account = self._known[owner, key] = QuotaUsage(owner, name, quota)
        elif account.quota != quota:
            account.adopt(quota)
        if quota.queue_bytes is not None and self._timer is None:
            self._timer = self._loop.call_later(SWEEP, self._look)
        return account

    def _quota_of(self, principal: Principal) -> Quota:
        default = self._settings.config.quotas.principal
        roles = self._rules.roles
        held = [roles[name].quota or default for name in principal.roles if name in roles]
        return _most_generous(default, held or [default])

    def _prune(self) -> None:
        moment = perf_counter()
        for key in [key for key, account in self._known.items() if account.idle(moment)]:
            del self._known[key]

    # -- sessions and what they hold -----------------------------------------------------------

    def enter(self, session: Session, drop: Callable[[Session], None]) -> None:
        """Count a new session; `drop` ends one that has to make room.

        Where the quota is reached only with those that wait for their client's return, the one that
        has waited longest goes: but one, as this client may be about to come back to it.

        :raises QueueFull: as many as allowed are connected.
        """
        self.attach(session)
        if session.token_bucket is None:
            return
        for account in session.token_bucket.accounts:
            self._check_session(account, drop)
        for account in session.token_bucket.accounts:
            account.sessions.add(session)

    def _check_session(self, account: QuotaUsage[Session], drop: Callable[[Session], None]) -> None:
        limit = account.quota.sessions
        if limit is None:
            return
        if account.connected >= limit:
            raise account.full("sessions", limit)
        if len(account.sessions) > limit:
            waiting = [session for session in account.sessions if session.cut is not None]
            drop(min(waiting, key=lambda session: session.cut or 0))

    def leave(self, session: Session) -> None:
        """Count a session no more."""
        if session.token_bucket is not None:
            for account in session.token_bucket.accounts:
                account.sessions.discard(session)

    def move(self, session: Session) -> None:
        """Bring a session under the quotas that concern it now."""
        self.leave(session)
        self.attach(session)
        if session.token_bucket is not None and session.id in self._sessions:
            for account in session.token_bucket.accounts:
                account.sessions.add(session)

    def change_tenant(self, session: Session, tenant: str | None) -> None:
        """Have a session act for another tenant.

        :raises QueueFull: that tenant has as many sessions as it may; nothing changed.
        """
        before, session.tenant = session.tenant, tenant
        if before == tenant:
            return
        old = session.token_bucket.accounts if session.token_bucket is not None else ()
        self.move(session)
        try:
            for account in (
                session.token_bucket.accounts if session.token_bucket is not None else ()
            ):
                limit = account.quota.sessions
                if account not in old and limit is not None and account.connected > limit:
                    raise account.full("sessions", limit)
        except QueueFull:
            session.tenant = before
            self.move(session)
            raise

    def check_subscription(self, session: Session) -> None:
        """Refuse one subscription too many.

        :raises QueueFull: its tenant or principal has as many as it may.
        """
        if session.token_bucket is not None:
            for account in session.token_bucket.accounts:
                limit = account.quota.subscriptions
                if limit is not None and account.subscriptions >= limit:
                    raise account.full("subscriptions", limit)

    def check_command(self, session: Session, path: str) -> None:
        """Refuse one command or plan too many; others of the gateway's own branch are past it.

        :raises QueueFull: its tenant or principal has as many as it may.
        """
        if session.token_bucket is None or (path.startswith("/system/") and path != _PLANS):
            return
        for account in session.token_bucket.accounts:
            what, limit, held = "commands", account.quota.commands, account.commands
            if path == _PLANS:
                what, limit, held = "plans", account.quota.plans, account.plans
            if limit is not None and len(held) >= limit:
                raise account.full(what, limit)

    def charge(self, session: Session, command: Command) -> None:
        """Count a command until it ends."""
        if session.token_bucket is None:
            return
        id_ = command.id
        self._charged[id_] = session.token_bucket.accounts
        for account in session.token_bucket.accounts:
            (account.plans if command.path == _PLANS else account.commands).add(id_)
        command.followers.append(lambda reply: self._release(id_) if reply.final else None)

    def _release(self, id_: str) -> None:
        for account in self._charged.pop(id_, ()):
            account.commands.discard(id_)
            account.plans.discard(id_)

    def recount(self) -> None:
        """Count the running commands afresh: the quotas have changed."""
        for accounts in self._charged.values():
            for account in accounts:
                account.commands.clear()
                account.plans.clear()
        self._charged.clear()
        for command in self._running.values():
            if command.asker is not None:
                self.move(command.asker)
                self.charge(command.asker, command)

    # -- what waits for slow clients -----------------------------------------------------------

    def _look(self) -> None:
        accounts = [a for a in self._known.values() if a.quota.queue_bytes is not None]
        self._timer = self._loop.call_later(SWEEP, self._look) if accounts else None
        for account in accounts:
            _weigh(account, account.quota.queue_bytes or 0)

    def close(self) -> None:
        """Look at nothing any more."""
        if self._timer is not None:
            self._timer.cancel()

    # -- for people ----------------------------------------------------------------------------

    def plain(self, session: Session) -> dict[str, Any]:
        """Describe the asker's own quota and use, and those of the tenants it acts in."""
        tenants = session.rights.tenants
        out: dict[str, Any] = {}
        own = self._known.get(("principal", session.principal.identity))
        if own is not None:
            out["principal"] = own.usage()
        shown = {
            a.name: a.usage() for a in self.of("tenant") if "*" in tenants or a.name in tenants
        }
        return out | ({"tenants": shown} if shown else {})

    def refused(self) -> dict[tuple[str, str, str], int]:
        """Count refusals by owner, tenant and thing; all principals count together."""
        sums: dict[tuple[str, str, str], int] = {}
        for account in self._known.values():
            tenant = account.name if account.owner == "tenant" else ""
            for what, count in account.refused.items():
                key = account.owner, tenant, what
                sums[key] = sums.get(key, 0) + count
        return sums

    def of(self, owner: Owner) -> Iterable[QuotaUsage[Session]]:
        """Go through the accounts of tenants or principals."""
        return [account for account in self._known.values() if account.owner == owner]


def _weigh(account: QuotaUsage[Session], limit: int) -> None:
    """Have the slowest clients give way until what waits is within the quota, or ask no more."""
    held = sorted(((waiting_bytes(s), s) for s in account.sessions), key=_by_size, reverse=True)
    total = sum(size for size, _ in held)
    account.waiting = total
    over = total - limit
    reason = (
        f"ended: the clients of this {account.owner} have more than the {limit} unread bytes of "
        "its quota"
    )
    for size, session in held:
        if over > 0:
            account.refused["queue_bytes"] = account.refused.get("queue_bytes", 0) + 1
            over -= size - shed(session, reason)
        meter = session.token_bucket
        if meter is None:
            continue
        left = over > 0 and waiting_bytes(session) > 0
        if left:
            meter.choked = account
            over -= waiting_bytes(session)
        elif meter.choked is account:
            meter.choked = None


def _by_size(item: tuple[int, Any]) -> int:
    return item[0]


def _most_generous(default: Quota, quotas: list[Quota]) -> Quota:
    """Join what several roles give: of each thing the most.

    A role that does not name a thing gives of it what the default gives.
    """
    out: dict[str, Any] = {}
    for what in ("sessions", "subscriptions", "commands", "plans", "queue_bytes", "requests"):
        given = [getattr(q, what) or getattr(default, what) for q in quotas]
        out[what] = None if None in given else max(given)
    if out["requests"] is not None:
        at_that_pace = [q for q in (*quotas, default) if q.requests == out["requests"]]
        bursts = [q.burst or max(1, round(q.requests or 1)) for q in at_that_pace]
        out["burst"] = max(bursts)
    return Quota(**out)
