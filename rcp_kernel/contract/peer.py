"""The other end of a connection, as the transport knows it."""

from __future__ import annotations

import msgspec

__all__ = ["UNKNOWN", "Certificate", "Peer", "Serial"]

Serial = tuple[str, int]
"""Issuer and number: how a list of revoked certificates names one."""


class Certificate(msgspec.Struct, frozen=True):
    """The facts of a client certificate that the transport has verified."""

    subject: str
    """RFC 4514."""
    common_name: str | None
    sans: tuple[str, ...]
    """`DNS:…`, `URI:…` and `email:…`."""
    issuer: str
    """RFC 4514."""
    serial: int
    expires: int
    """ns since the UNIX epoch."""
    fingerprint: str
    """SHA-256, in hex."""


class Peer(msgspec.Struct, frozen=True):
    """The client at the other end."""

    address: str | None = None
    """IP address of the client, or of the proxy in between."""
    certificate: Certificate | None = None


UNKNOWN = Peer()
"""The peer of a transport that has none, such as one in memory."""
