"""The options of `use = "fleet"`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_hubs.signer import read_private_key
from rcp_kernel.errors import ConfigError
from rcp_zenoh.config import Chunk
from rcp_zenoh.tls import TlsConfig, check_links

__all__ = ["FleetConfig", "check_hub"]


class FleetConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A hub's side of the fleet. Times in seconds."""

    hub: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
    """The name of this hub, which no other one has."""
    listen: tuple[str, ...] = ()
    """Endpoints of the router in this process: `tcp/0.0.0.0:7447`; none: `connect` to one."""
    connect: tuple[str, ...] = ()
    """Endpoints of other routers."""
    tls: TlsConfig | None = None
    """Certificates of the links; its router then serves nobody but `robots` and `hubs`."""
    robots: tuple[Chunk, ...] = ()
    """Ids of the gateways that its router serves, which are the names in their certificates."""
    hubs: tuple[Chunk, ...] = ()
    """Ids of other hubs that it serves."""
    routers: tuple[Chunk, ...] = ()
    """Ids of other hubs whose routers are linked with its own: they speak for their robots."""
    key: str | None = None
    """File of its Ed25519 private key in PEM, with which it asserts persons to the gateways."""
    revoked: str | None = None
    """File with the signed list of revoked hubs, which it publishes: `rcpd fleet revoke`."""
    roles: tuple[str, ...] = ()
    """Roles that it asserts; others of a person stay here. Empty: all."""
    idle: Annotated[float, Meta(gt=0)] = 60.0
    """Without a request, after which the session of a person with a robot is closed."""
    token: str | None = None
    """Instead of `key`, for trials: a key of the gateways, as which everybody acts."""
    connect_timeout: Annotated[float, Meta(gt=0)] = 5.0
    """For a gateway's answer to `hello`."""
    silence: Annotated[float, Meta(ge=0.3)] = 3.0
    """After which a link counts as broken; also Zenoh's own lease."""


def check_hub(config: FleetConfig) -> None:
    """Check what the types of the options cannot.

    :raises ConfigError: there is no router, an option lacks another, or a file cannot be used.
    """
    if not config.listen and not config.connect:
        raise ConfigError("no router: `listen` makes this hub one, `connect` names others")
    if (config.key is None) == (config.token is None):
        raise ConfigError(
            "write either `key`, the file of this hub's private key, or `token`, for a trial in "
            "which everybody acts as the hub"
        )
    if config.key is not None:
        read_private_key(config.key, "`key`")
    check_links((*config.listen, *config.connect), config.tls)
    ruled = config.robots or config.hubs or config.routers
    if ruled and (config.tls is None or not config.listen):
        raise ConfigError(
            "`robots`, `hubs` and `routers` are the rules of a router with `listen` and `tls`"
        )
