"""What `[transports.asgi]` may say."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["AsgiConfig", "TlsConfig"]


class TlsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """TLS by the listener itself. Files are PEM, and read again whenever they change."""

    certificate: Annotated[str, Meta(min_length=1)]
    """The gateway's certificate, with what leads up to its CA."""
    key: Annotated[str, Meta(min_length=1)]
    key_password: str | None = None
    """Of an encrypted key, by `${NAME}`."""
    client_ca: str | None = None
    """Who signs the certificates of clients."""
    client_certificates: Literal["none", "optional", "required"] = "none"
    crl: str | None = None
    """Certificates of clients that are not good any more, of each CA in `client_ca`."""


class AsgiConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The one listener. Sizes in bytes, times in seconds."""

    host: Annotated[str, Meta(min_length=1)] = "127.0.0.1"
    """Address to listen on; one that is not loopback wants authentication and TLS."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 8080
    """0 takes a free one."""
    tls: TlsConfig | None = None
    plaintext: bool = False
    """Speak plain HTTP on an address open to others: for those behind a proxy that adds TLS."""
    origins: tuple[Annotated[str, Meta(pattern=r"^(\*|[a-z+.-]+://[^/\s]+/?)$")], ...] = ()
    """Web pages that may use the gateway beside its own: `https://ui.example.org`, or `*`."""
    hosts: tuple[str, ...] = ()
    """Names that requests may address; on loopback its names are there already, elsewhere any is.
    """
    root_path: Annotated[str, Meta(pattern="^(/[A-Za-z0-9_.~-]+)*$")] = ""
    """Path below which a reverse proxy shows the gateway."""
    proxies: tuple[str, ...] = ()
    """Addresses and networks of reverse proxies whose `X-Forwarded-For` is believed."""
    connections: Annotated[int, Meta(ge=1)] = 2000
    """Open at once."""
    connections_per_address: Annotated[int, Meta(ge=1)] | None = None
    """Open at once from one address; None: 256, and no limit for this machine's own."""
    connection_rate: Annotated[float, Meta(gt=0)] | None = None
    """New ones a second from one address, in bursts of twice as many; None: as above, 50."""
    compression: Literal["auto", "always", "never"] = "auto"
    """permessage-deflate: `auto` compresses text for peers on other machines."""
    compress_above: Annotated[int, Meta(ge=0)] = 1024
    """Shorter WebSocket messages are never compressed."""
    max_header: Annotated[int, Meta(ge=1024)] = 32 * 1024
    """Request line and headers together."""
    header_timeout: Annotated[float, Meta(gt=0)] = 10.0
    """For a TLS handshake, and for the whole of a request's headers to come in."""
    body_timeout: Annotated[float, Meta(gt=0)] = 60.0
    """For the whole of a request's body; then the connection is cut."""
    keep_alive: Annotated[int, Meta(ge=1)] = 75
    """That an idle HTTP connection is kept."""
    grace: Annotated[float, Meta(ge=0)] = 1.0
    """That clients have to go when the gateway stops."""
