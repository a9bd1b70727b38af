"""The configuration of `[transports.zenoh]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_zenoh.tls import TlsConfig

__all__ = ["Chunk", "ZenohConfig"]

Chunk = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
"""One chunk of a key expression that is also a segment of a path."""


class ZenohConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a gateway joins its fleet. Times in seconds."""

    gateway: Chunk
    """Its id in the fleet: the segment after the branch in the hubs' trees."""
    tenant: Chunk
    """The tenant under which hubs show it."""
    connect: Annotated[tuple[str, ...], Meta(min_length=1)]
    """Endpoints of the routers: `tcp/hub.example:7447`, `tls/…`, `quic/…`."""
    fleet_key: str | None = None
    """Ed25519 public key, as PEM or file path, that signs the list of revoked hubs."""
    tls: TlsConfig | None = None
    """Certificates, without which an endpoint must be `tcp/…`."""
    patience: Annotated[float, Meta(gt=0)] = 10.0
    """For a hub's `hello`, which says who it is."""
    budget: Annotated[int, Meta(ge=1000)] | None = None
    """Bytes/s for all hubs together. Updates wait; commands and replies may exceed it, and an e-stop
    is not counted."""
    silence: Annotated[float, Meta(ge=0.3)] = 3.0
    """After which a link counts as broken; also Zenoh's own lease."""
