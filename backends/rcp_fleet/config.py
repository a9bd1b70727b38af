"""The options of `use = "fleet"`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_zenoh.config import Chunk
from rcp_zenoh.tls import TlsConfig

__all__ = ["FleetConfig"]


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
