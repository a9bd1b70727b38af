"""The configuration of quotas: `[quotas]`, and `quota` of each tenant and role."""

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
    """A quota; values that are not set are limited by `[limits]` alone."""

    requests: Annotated[float, Meta(gt=0, le=1_000_000)] | None = None
    """Average rate, per second."""
    burst: _Count | None = None
    """Burst size in requests; by default those of one second."""
    sessions: _Count | None = None
    """Connected sessions."""
    subscriptions: _Count | None = None
    commands: _Count | None = None
    """Running or queued commands."""
    plans: _Count | None = None
    """Running plans."""
    queue_bytes: Annotated[int, Meta(ge=1024)] | None = None
    """Unread bytes of all clients."""

    @property
    def at_once(self) -> int:
        """Burst size in requests, if the rate is limited."""
        return self.burst or max(1, round(self.requests or 1))

    @property
    def pace(self) -> tuple[float, float]:
        """Seconds that a request costs, and the seconds of burst allowed."""
        if self.requests is None:
            return 0.0, float("inf")
        interval = 1.0 / self.requests
        return interval, (self.at_once - 1) * interval + interval * 1e-6


NONE = Quota()


class Quotas(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Default quotas for principals whose roles set none."""

    principal: Quota = NONE
    """Quota of each principal."""


class _Owner(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The quota of a tenant or role."""

    quota: Quota | None = None


class QuotaTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All quotas of a gateway, under their names in the file."""

    quotas: Quotas = Quotas()
    tenants: dict[str, _Owner] = {}
    roles: dict[str, _Owner] = {}
    """All roles."""

    def of_tenant(self, tenant: str | None) -> Quota | None:
        """Return the quota shared by all principals of a tenant."""
        owner = self.tenants.get(tenant or "")
        return None if owner is None else owner.quota

    def of_roles(self, names: Iterable[str]) -> Quota | None:
        """Return the quota of a principal with some roles; None if there is none."""
        default = self.quotas.principal
        held = [self.roles[name].quota or default for name in names if name in self.roles]
        quota = _most_generous(default, held or [default])
        return None if quota == NONE else quota


def from_gateway(config: GatewayConfig) -> dict[str, Any]:
    """Return the quotas from their places in the file."""
    roles = {**BUILTIN_ROLES, **config.roles}
    return {
        "quotas": config.quotas,
        "tenants": {name: {"quota": tenant.quota} for name, tenant in config.tenants.items()},
        "roles": {name: {"quota": role.quota} for name, role in roles.items()},
    }


def _most_generous(default: Quota, quotas: list[Quota]) -> Quota:
    """Combine the quotas of several roles: the largest of each value.

    A value that a role does not set counts as the default.
    """
    out: dict[str, Any] = {}
    for what in ("sessions", "subscriptions", "commands", "plans", "queue_bytes", "requests"):
        given = [getattr(q, what) or getattr(default, what) for q in quotas]
        out[what] = None if None in given else max(given)
    if out["requests"] is not None:
        at_that_pace = [q for q in (*quotas, default) if q.requests == out["requests"]]
        out["burst"] = max(q.at_once for q in at_that_pace)
    return Quota(**out)
