"""Quota tracking: the use of the gateway by each tenant and each principal.

There are no counters to keep balanced: an owner's sessions are in a set, and their use is summed on
demand, so that no way to end a session can be missed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rcp_kernel.features import FeatureHost
from rcp_kernel.sessions.session import Session
from rcp_quotas.bucket import TokenBucket
from rcp_quotas.config import Quota, QuotaTables
from rcp_quotas.unread import UnreadLimit
from rcp_quotas.usage import Owner, QuotaUsage

__all__ = ["QuotaTracker"]

_MANY = 10_000  # usages, before idle ones are removed


class QuotaTracker:
    """The usage of all tenants and principals that have a quota."""

    def __init__(self, tables: QuotaTables, host: FeatureHost) -> None:
        self.tables = tables
        self._monotonic = host.clock.monotonic
        self._known: dict[tuple[Owner, Any], QuotaUsage] = {}
        self._buckets: dict[Session, TokenBucket] = {}
        """The buckets of the counted sessions."""
        self._unread = UnreadLimit(host, self._known.values, self._buckets)
        self.close = self._unread.close

    # -- applicable quotas -----------------------------------------------------------------------

    def attach(self, session: Session) -> TokenBucket | None:
        """Return the bucket for a session's requests; None if no quota applies."""
        usages = self._usages(session)
        known = self._buckets.get(session)
        if known is not None and known.usages == usages:
            return known
        return TokenBucket(usages) if usages else None

    def _usages(self, session: Session) -> tuple[QuotaUsage, ...]:
        principal = session.principal
        quota = self.tables.of_roles(principal.roles)
        own = self._usage("principal", principal.identity, principal.name, quota)
        shared = self._of_tenant(session.tenant)
        return tuple(usage for usage in (own, shared) if usage is not None)

    def _of_tenant(self, tenant: str | None) -> QuotaUsage | None:
        name = tenant or ""
        return self._usage("tenant", name, name, self.tables.of_tenant(tenant))

    def _usage(self, owner: Owner, key: Any, name: str, quota: Quota | None) -> QuotaUsage | None:
        if quota is None:
            return None
        usage = self._known.get((owner, key))
        if usage is None:
            if len(self._known) >= _MANY:
                self._prune()
            usage = self._known[owner, key] = QuotaUsage(owner, name, quota)
        elif usage.quota != quota:
            usage.adopt(quota)
        if quota.queue_bytes is not None:
            self._unread.start()
        return usage

    def _prune(self) -> None:
        moment = self._monotonic()
        for key in [key for key, usage in self._known.items() if usage.idle(moment)]:
            del self._known[key]

    # -- sessions ------------------------------------------------------------------------------

    def enter(self, session: Session, drop: Callable[[Session], None]) -> TokenBucket | None:
        """Count a new session.

        If the quota is reached only with sessions that await their client's return, the oldest of
        these is dropped; one is kept, as this client may be about to resume it.

        :raises QueueFull: as many as allowed are connected.
        """
        for usage in self._usages(session):
            _check_session(usage, drop)
        return self.move(session)

    def move(self, session: Session) -> TokenBucket | None:
        """Move a session to the quotas that apply now."""
        bucket = self.attach(session)
        self.leave(session)
        if bucket is not None:
            self._buckets[session] = bucket
            for usage in bucket.usages:
                usage.sessions.add(session)
        return bucket

    def check_tenant(self, session: Session, tenant: str | None) -> None:
        """Check that a tenant may have another session before one switches to it.

        :raises QueueFull: the tenant has as many as allowed.
        """
        usage = self._of_tenant(tenant)
        if usage is not None:
            usage.check_connected()

    def leave(self, session: Session) -> None:
        """Stop counting a session."""
        bucket = self._buckets.pop(session, None)
        if bucket is not None:
            for usage in bucket.usages:
                usage.sessions.discard(session)

    def forget_commands(self) -> None:
        """Reset the count of running commands."""
        for usage in self._known.values():
            usage.commands.clear()
            usage.plans.clear()

    # -- reports -------------------------------------------------------------------------------

    def plain(self, session: Session) -> dict[str, Any]:
        """Describe the reader's own quota and use, and those of its tenants."""
        tenants = session.rights.tenants
        out: dict[str, Any] = {}
        own = self._known.get(("principal", session.principal.identity))
        if own is not None:
            out["principal"] = own.plain()
        shown = {
            a.name: a.plain() for a in self.of("tenant") if "*" in tenants or a.name in tenants
        }
        return out | ({"tenants": shown} if shown else {})

    def refused(self) -> dict[tuple[str, str, str], int]:
        """Return the number of refusals by owner, tenant and resource; principals are summed."""
        sums: dict[tuple[str, str, str], int] = {}
        for usage in self._known.values():
            tenant = usage.name if usage.owner == "tenant" else ""
            for what, count in usage.refused.items():
                key = usage.owner, tenant, what
                sums[key] = sums.get(key, 0) + count
        return sums

    def of(self, owner: Owner) -> Iterable[QuotaUsage]:
        """Iterate over the usages of tenants or principals."""
        return [usage for usage in self._known.values() if usage.owner == owner]


def _check_session(usage: QuotaUsage, drop: Callable[[Session], None]) -> None:
    usage.check_connected()
    limit = usage.quota.sessions
    if limit is not None and len(usage.sessions) > limit:
        waiting = [session for session in usage.sessions if session.cut is not None]
        drop(min(waiting, key=lambda session: session.cut or 0))
