"""The configuration of `[transports.asgi]`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["AsgiConfig", "TlsConfig"]


class TlsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """TLS in the listener itself. Files are PEM, and reloaded when they change."""

    certificate: Annotated[str, Meta(min_length=1)]
    """The gateway's certificate, with the intermediate ones up to its CA."""
    key: Annotated[str, Meta(min_length=1)]
    key_password: str | None = None
    """Password of an encrypted key, by `${NAME}`."""
    client_ca: str | None = None
    """CA that signs client certificates."""
    client_certificates: Literal["none", "optional", "required"] = "none"
    crl: str | None = None
    """Revoked client certificates, from each CA in `client_ca`."""


class AsgiConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The listener. Sizes in bytes, times in seconds."""

    host: Annotated[str, Meta(min_length=1)] = "127.0.0.1"
    """Address to listen on; other than loopback it requires authentication and TLS."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 8080
    """Port; 0 takes a free one."""
    tls: TlsConfig | None = None
    plaintext: bool = False
    """Allow plain HTTP on a non-loopback address, behind a proxy that adds TLS."""
    origins: tuple[Annotated[str, Meta(pattern=r"^(\*|[a-z+.-]+://[^/\s]+/?)$")], ...] = ()
    """Other origins that may use the gateway: `https://ui.example.org`, or `*`."""
    hosts: tuple[str, ...] = ()
    """Host names that requests may use. On loopback its own names are always allowed; elsewhere, if
    empty, any name is."""
    root_path: Annotated[str, Meta(pattern="^(/[A-Za-z0-9_.~-]+)*$")] = ""
    """Path prefix under which a reverse proxy serves the gateway."""
    proxies: tuple[str, ...] = ()
    """Addresses and networks of reverse proxies whose `X-Forwarded-For` is trusted."""
    connections: Annotated[int, Meta(ge=1)] = 2000
    """Maximum number of open connections."""
    connections_per_address: Annotated[int, Meta(ge=1)] | None = None
    """Maximum per client address; None: 256, and no limit for this machine."""
    connection_rate: Annotated[float, Meta(gt=0)] | None = None
    """New connections per second and address, with bursts of twice as many; None: 50, see above."""
    compression: Literal["auto", "always", "never"] = "auto"
    """permessage-deflate: `auto` compresses text for clients on other machines."""
    compress_above: Annotated[int, Meta(ge=0)] = 1024
    """Minimum size of WebSocket messages to compress."""
    max_header: Annotated[int, Meta(ge=1024)] = 32 * 1024
    """Maximum size of request line and headers together."""
    header_timeout: Annotated[float, Meta(gt=0)] = 10.0
    """Time-out for a TLS handshake, and for receiving all headers of a request."""
    body_timeout: Annotated[float, Meta(gt=0)] = 60.0
    """Time-out for receiving the body of a request; then the connection is closed."""
    keep_alive: Annotated[int, Meta(ge=1)] = 75
    """Time that an idle HTTP connection is kept open."""
    grace: Annotated[float, Meta(ge=0)] = 1.0
    """Time that clients have to disconnect when the gateway stops."""
