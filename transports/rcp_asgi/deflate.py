"""permessage-deflate (RFC 7692) without context takeover: no memory held between messages."""

from __future__ import annotations

import zlib

__all__ = ["RESPONSE", "TooLong", "deflate", "inflate", "offered"]

_TAIL = b"\x00\x00\xff\xff"  # RFC 7692 7.2.1: cut off by the sender, put back by the receiver
_KNOWN = frozenset(
    (
        "client_no_context_takeover",
        "server_no_context_takeover",
        "client_max_window_bits",
        "server_max_window_bits",
    )
)
RESPONSE = "permessage-deflate; server_no_context_takeover; client_no_context_takeover"


class TooLong(Exception):
    """A message is longer than allowed once it is inflated."""


def offered(extensions: str) -> bool:
    """Tell whether a client's `Sec-WebSocket-Extensions` holds an offer that can be accepted."""
    return any(_acceptable(offer) for offer in extensions.split(","))


def _acceptable(offer: str) -> bool:
    name, *parameters = (part.strip() for part in offer.split(";"))
    if name.lower() != "permessage-deflate":
        return False
    seen: set[str] = set()
    for parameter in parameters:
        key, _, value = (part.strip() for part in parameter.partition("="))
        if key not in _KNOWN or key in seen:
            return False
        seen.add(key)
        # The answer names no window size, so the largest one must do for the client.
        if key == "server_max_window_bits" and value.strip('"') != "15":
            return False
    return True


def deflate(data: bytes) -> bytes:
    """Compress one message."""
    compressor = zlib.compressobj(1, zlib.DEFLATED, -15)
    return (compressor.compress(data) + compressor.flush(zlib.Z_SYNC_FLUSH))[:-4]


def inflate(data: bytes, limit: int) -> bytes:
    """Decompress one message.

    :raises TooLong: it has more than `limit` bytes.
    :raises zlib.error: it is damaged.
    """
    decompressor = zlib.decompressobj(-15)
    out = decompressor.decompress(data + _TAIL, limit + 1)
    if len(out) > limit:
        raise TooLong
    return out
