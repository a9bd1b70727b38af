"""`[[hubs]]`: the hubs that may speak for persons, their keys, and the roles they may assert."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_hubs.revocation import fleet_key
from rcp_jwt.jwks import PublicKey, read_static
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.identity import check_grants
from rcp_kernel.config.role import BUILTIN_ROLES
from rcp_kernel.contract.identity import granted
from rcp_kernel.errors import ConfigError

__all__ = ["HubConfig", "HubTables", "check_tables", "public_keys", "table_of"]

_Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]


class HubConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A hub that may assert persons to this gateway; times in s."""

    id: _Name
    """The hub's id: `hub` in its own configuration."""
    public_key: str | tuple[str, ...]
    """Its Ed25519 public key: PEM or JWK, as text or as a file path; several during a change."""
    roles: Annotated[tuple[str, ...], Meta(min_length=1)]
    """Roles that it may assert; an assertion with any other is refused as a whole."""
    tenants: tuple[str, ...] = ()
    """Tenants in which the roles hold; empty: the tenant of `[transports.zenoh]`."""
    people: _Name | None = None
    """Hubs with the same `people` mean the same person by the same name. Default: the hub's id."""
    leeway: Annotated[float, Meta(ge=0, le=60)] = 10.0
    """Tolerated clock difference."""


class HubTables(msgspec.Struct, frozen=True, kw_only=True):
    """All `[[hubs]]`, and what they refer to."""

    hubs: tuple[HubConfig, ...] = ()
    gateway: str | None = None
    """This gateway's id in the fleet, from `[transports.zenoh]`."""
    tenant: str | None = None
    """The tenant under which hubs show it."""
    fleet_key: str | None = None
    """Public key of the fleet, which signs the list of revoked hubs."""
    effective_roles: frozenset[str] = frozenset()
    """The roles that grant anything."""

    @property
    def audience(self) -> str:
        """What `aud` must be."""
        return f"{self.tenant}/{self.gateway}"

    def tenants_of(self, hub: HubConfig) -> tuple[str, ...]:
        """Return the tenants in which the roles asserted by a hub hold."""
        return hub.tenants or (() if self.tenant is None else (self.tenant,))


def table_of(gateway: GatewayConfig) -> dict[str, object]:
    """Return the data of `HubTables` from the whole configuration."""
    link: dict[str, Any] = gateway.transports.get("zenoh", {})
    return {
        "hubs": list(gateway.hubs),
        "gateway": link.get("gateway"),
        "tenant": link.get("tenant"),
        "fleet_key": link.get("fleet_key"),
        "effective_roles": gateway.effective_roles,
    }


def check_tables(tables: HubTables, gateway: GatewayConfig) -> None:
    """Check what the types of the tables cannot.

    :raises ConfigError: a table refers to something unknown, or a key is no Ed25519 key.
    """
    if tables.hubs and (tables.gateway is None or tables.tenant is None):
        raise ConfigError(
            "[[hubs]] needs [transports.zenoh] with `gateway` and `tenant`: hubs assert persons to "
            "a gateway by its name"
        )
    roles = {**BUILTIN_ROLES, **gateway.roles}
    for hub in tables.hubs:
        where = f"[[hubs]] '{hub.id}'"
        grants = granted(tables.tenants_of(hub), hub.roles)
        check_grants(grants, where, gateway.tenant_names, roles)
    public_keys(tables.hubs)
    if tables.fleet_key is not None:
        fleet_key(tables.fleet_key)


def public_keys(hubs: Iterable[HubConfig]) -> dict[str, tuple[PublicKey, ...]]:
    """Read the keys of all hubs.

    :raises ConfigError: one is not an Ed25519 public key, or two tables have the same id.
    """
    found: dict[str, tuple[PublicKey, ...]] = {}
    for hub in hubs:
        where = f"[[hubs]] '{hub.id}'"
        if hub.id in found:
            raise ConfigError(f"two [[hubs]] tables have the id '{hub.id}'")
        keys = read_static(hub.public_key, where, "public_key")
        if not keys or any(key.algorithm != "EdDSA" for key in keys):
            raise ConfigError(f"{where}: `public_key` must be an Ed25519 public key")
        found[hub.id] = keys
    return found
