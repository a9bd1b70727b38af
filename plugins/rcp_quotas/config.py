"""What the configuration says of quotas: `[quotas]`, and `quota` of each tenant and role."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import BUILTIN_ROLES

__all__ = ["NONE", "Quota", "QuotaTables", "Quotas", "from_gateway"]

_Count = Annotated[int, Meta(ge=1)]


class Quota(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A quota; what it does not set is bounded by `[limits]` alone."""

    requests: Annotated[float, Meta(gt=0, le=1_000_000)] | None = None
    """Per second, on average."""
    burst: _Count | None = None
    """Requests at once; default: those of one second."""
    sessions: _Count | None = None
    """Connected at once."""
    subscriptions: _Count | None = None
    commands: _Count | None = None
    """Running or queued."""
    plans: _Count | None = None
    """Running."""
    queue_bytes: Annotated[int, Meta(ge=1024)] | None = None
    """Unread bytes of all its clients."""

    @property
    def at_once(self) -> int:
        """Requests that may come at once, where their rate is limited."""
        return self.burst or max(1, round(self.requests or 1))

    @property
    def pace(self) -> tuple[float, float]:
        """Seconds that a request takes of its share, and how far ahead of it one may be."""
        if self.requests is None:
            return 0.0, float("inf")
        interval = 1.0 / self.requests
        return interval, (self.at_once - 1) * interval + interval * 1e-6


NONE = Quota()


class Quotas(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What holds for those whose roles say nothing."""

    principal: Quota = NONE
    """Of each principal."""


class _Owner(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A tenant or a role, as far as it is about quotas."""

    quota: Quota | None = None


class QuotaTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All quotas of a gateway, named as they are in the file."""

    quotas: Quotas = Quotas()
    tenants: dict[str, _Owner] = {}
    roles: dict[str, _Owner] = {}
    """Every role that there is."""

    def of_tenant(self, tenant: str | None) -> Quota | None:
        """Return what all principals of a tenant share."""
        owner = self.tenants.get(tenant or "")
        return None if owner is None else owner.quota

    def of_roles(self, names: Iterable[str]) -> Quota | None:
        """Return what a principal with some roles has; None if that is no quota."""
        default = self.quotas.principal
        held = [self.roles[name].quota or default for name in names if name in self.roles]
        quota = _most_generous(default, held or [default])
        return None if quota == NONE else quota


def from_gateway(config: GatewayConfig) -> dict[str, Any]:
    """Take the quotas from where they are in the file."""
    roles = {**BUILTIN_ROLES, **config.roles}
    return {
        "quotas": config.quotas,
        "tenants": {name: {"quota": tenant.quota} for name, tenant in config.tenants.items()},
        "roles": {name: {"quota": role.quota} for name, role in roles.items()},
    }


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
        out["burst"] = max(q.at_once for q in at_that_pace)
    return Quota(**out)
