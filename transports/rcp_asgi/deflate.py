"""permessage-deflate (RFC 7692) without context takeover: no memory is kept between messages."""

from __future__ import annotations

import re
import zlib

__all__ = ["TooLong", "accept_offer", "deflate", "inflate"]

_TAIL = b"\x00\x00\xff\xff"  # RFC 7692 7.2.1: removed by the sender, restored by the receiver
_TOKEN = re.compile(r"[!#$%&'*+.^_`|~0-9A-Za-z-]+")
_QUOTED = re.compile(r'"([^"]*)"')
_BITS = frozenset(str(bits) for bits in range(8, 16))
_RESPONSE = "permessage-deflate; server_no_context_takeover; client_no_context_takeover"


class TooLong(Exception):
    """A message exceeds the limit after decompression."""


def accept_offer(extensions: str) -> str | None:
    """Return the response to a client's `Sec-WebSocket-Extensions`; None declines all offers.

    Invalid offers are declined, never corrected (RFC 7692, 7).
    """
    for offer in _QUOTED.sub(_unquoted, extensions).split(","):
        parameters = _parameters(offer)
        if parameters is not None and _acceptable(parameters):
            # RFC 7692 7.1.2.1: accepting this parameter requires returning it.
            named = "server_max_window_bits" in parameters
            return _RESPONSE + ("; server_max_window_bits=15" if named else "")
    return None


def _unquoted(match: re.Match[str]) -> str:
    return match[1] if _TOKEN.fullmatch(match[1]) else "?,?"  # no valid value


def _parameters(offer: str) -> dict[str, str | None] | None:
    """Parse one offer of permessage-deflate; None if it is another extension or malformed."""
    name, *parts = (part.strip(" \t") for part in offer.split(";"))
    if name.lower() != "permessage-deflate":
        return None
    found: dict[str, str | None] = {}
    for part in parts:
        key, equals, value = (text.strip(" \t") for text in part.partition("="))
        if key in found or not _TOKEN.fullmatch(key) or (equals and not _TOKEN.fullmatch(value)):
            return None
        found[key] = value if equals else None
    return found


def _acceptable(parameters: dict[str, str | None]) -> bool:
    for key, value in parameters.items():
        match key:
            case "server_no_context_takeover" | "client_no_context_takeover":
                good = value is None
            case "client_max_window_bits":
                good = value is None or value in _BITS
            case "server_max_window_bits":  # a smaller window is valid but not supported
                good = value == "15"
            case _:
                good = False
        if not good:
            return False
    return True


def deflate(data: bytes) -> bytes:
    """Compress one message."""
    compressor = zlib.compressobj(1, zlib.DEFLATED, -15)
    return (compressor.compress(data) + compressor.flush(zlib.Z_SYNC_FLUSH))[:-4]


def inflate(data: bytes, limit: int) -> bytes:
    """Decompress one message.

    :raises TooLong: it exceeds `limit` bytes.
    :raises zlib.error: it is damaged.
    """
    decompressor = zlib.decompressobj(-15)
    out = decompressor.decompress(data + _TAIL, limit + 1)
    if len(out) > limit:
        raise TooLong
    return out
