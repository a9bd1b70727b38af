"""`[safety]`: settings for all commands to robots."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.errors import ConfigError, InvalidPath
from rcp_kernel.model import parse_path, tenant_of

__all__ = ["Safety", "check_groups"]


class Safety(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Control of robots; times in seconds."""

    lease_required: tuple[str, ...] = ()
    """Patterns of paths that accept commands only under a lease."""
    lease_ttl: Annotated[float, Meta(gt=0, le=1e9)] = 10.0
    """Default duration of a lease."""
    lease_ttl_max: Annotated[float, Meta(gt=0, le=1e9)] = 300.0
    """Maximum duration of a lease."""
    approval_ttl: Annotated[float, Meta(gt=0, le=86_400)] = 300.0
    """Time in s for which an approval can be decided and used."""
    guard: bool = True
    """Whether the guard process stops the robots when the gateway's event loop is blocked."""
    guard_after: Annotated[float, Meta(ge=0.1, le=10)] = 0.5
    """Time in s for which the event loop may be blocked while something may move."""
    guard_bound: Annotated[float, Meta(ge=1, le=3600)] = 10.0
    """Maximum time for which the guard sends stops."""
    groups: dict[str, tuple[str, ...]] = {}
    """Scopes (`/tenant/alpha`, `/tenant/alpha/r1`) that one e-stop stops together, by group
    name."""


def check_groups(
    groups: dict[str, tuple[str, ...]],
    backends: Collection[str],
    tenants: Collection[str],
    source: str,
) -> None:
    """Refuse groups that name no part of the tree, or could be taken for a backend.

    :raises ConfigError: with the group.
    """
    where = f"{source}: [safety.groups]"
    for name, scopes in groups.items():
        if name in backends:
            raise ConfigError(f"{where} {name}: a backend has this name; rename the group")
        if not scopes or name.startswith("/"):
            raise ConfigError(f'{where} {name}: write <name> = ["/tenant/<tenant>/<robot>", …]')
        for scope in scopes:
            try:
                tenant = tenant_of(parse_path(scope, None))
            except InvalidPath:
                tenant = None
            if tenant not in tenants:
                raise ConfigError(
                    f"{where} {name}: {scope!r} is not in a tenant of this gateway; write "
                    f"/tenant/<tenant> or /tenant/<tenant>/<robot> with one of {', '.join(tenants)}"
                )
