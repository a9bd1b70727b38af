"""What `[transports.asgi]` may say."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["AsgiConfig"]


class AsgiConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The one listener. Sizes in bytes, times in seconds."""

    host: Annotated[str, Meta(min_length=1)] = "127.0.0.1"
    """Address to listen on; one that is not loopback wants authentication."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 8080
    """0 takes a free one."""
    origins: tuple[str, ...] = ()
    """Web pages that may use the gateway beside its own: `https://ui.example.org`, or `*`."""
    hosts: tuple[str, ...] = ()
    """Names that requests may address; on loopback its names are there already, elsewhere any is.
    """
    root_path: Annotated[str, Meta(pattern="^(/[A-Za-z0-9_.~-]+)*$")] = ""
    """Path below which a reverse proxy shows the gateway."""
    connections: Annotated[int, Meta(ge=1)] = 2000
    """Open at once."""
    compression: Literal["auto", "always", "never"] = "auto"
    """permessage-deflate: `auto` compresses text for peers on other machines."""
    compress_above: Annotated[int, Meta(ge=0)] = 1024
    """Shorter WebSocket messages are never compressed."""
    max_header: Annotated[int, Meta(ge=1024)] = 32 * 1024
    """Request line and headers together."""
    header_timeout: Annotated[float, Meta(gt=0)] = 10.0
    """For the whole of a request's headers to come in."""
    keep_alive: Annotated[int, Meta(ge=1)] = 75
    """That an idle HTTP connection is kept."""
    grace: Annotated[float, Meta(ge=0)] = 1.0
    """That clients have to go when the gateway stops."""
