"""Content negotiation: Accept, Content-Type, Accept-Encoding (RFC 9110)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Literal

from rcp_kernel.errors import BadRequest
from rcp_kernel.values import Encoding

__all__ = ["OCTETS", "Wanted", "accepted", "body_encoding", "coding"]

OCTETS = "application/octet-stream"
_TYPES = {
    "application/json": Encoding.JSON,
    "application/cbor": Encoding.CBOR,
    "application/msgpack": Encoding.MSGPACK,
    "application/x-msgpack": Encoding.MSGPACK,
    "application/vnd.msgpack": Encoding.MSGPACK,
}
_AS_JSON = {"", "application/x-www-form-urlencoded", "text/plain", "text/json"}
"""Content types that `curl -d` and `fetch` send by default."""
Wanted = tuple[Encoding, bool]
"""The encoding of envelopes, and whether values of bytes are wanted without an envelope."""
Coding = Literal["zstd", "gzip"]


def _weighed(text: str) -> Iterator[tuple[str, float]]:
    for part in text.split(","):
        name, *parameters = part.split(";")
        weight = 1.0
        for parameter in parameters:
            key, _, value = parameter.strip().partition("=")
            if key.strip().lower() == "q":
                try:
                    weight = float(value)
                except ValueError:
                    weight = 0.0
        yield name.strip().lower(), weight


@lru_cache(maxsize=256)
def accepted(accept: bytes) -> Wanted:
    """Choose the encoding that the client prefers.

    :raises BadRequest: it accepts none of the supported ones.
    """
    best: tuple[float, int, Encoding] | None = None
    octets = False
    for place, (name, weight) in enumerate(_weighed(accept.decode("latin-1"))):
        if weight <= 0:
            continue
        octets = octets or name == OCTETS
        found = _TYPES.get(name)
        if found is None and name in (
            "*/*",
            "application/*",
            "",
            OCTETS,
            "application/schema+json",
        ):
            found, place = Encoding.JSON, place + 1000  # noqa: PLW2901 - the more specific type first
        if found is not None and (best is None or (weight, -place) > best[:2]):
            best = (weight, -place, found)
    if best is None:
        raise BadRequest(
            f"none of the accepted media types is supported: {accept.decode('latin-1')[:100]}",
            remedy=f"Accept one of {', '.join(_TYPES)}.",
        )
    return best[2], octets


@lru_cache(maxsize=256)
def body_encoding(content_type: bytes) -> Encoding | None:
    """Return the encoding of a request's body; None is raw bytes.

    :raises BadRequest: the media type is not supported.
    """
    name = content_type.decode("latin-1").partition(";")[0].strip().lower()
    if name == OCTETS:
        return None
    if name in _AS_JSON or name.endswith("+json"):
        return Encoding.JSON
    found = _TYPES.get(name)
    if found is None:
        raise BadRequest(
            f"the media type {name[:100]!r} is not supported",
            remedy=f"Send one of {', '.join(_TYPES)}; {OCTETS} for a value of bytes.",
        )
    return found


@lru_cache(maxsize=256)
def coding(accept_encoding: bytes) -> Coding | None:
    """Choose a content coding: zstd before gzip, or none."""
    weights = dict(_weighed(accept_encoding.decode("latin-1")))
    for name in ("zstd", "gzip"):
        if weights.get(name, weights.get("*", 0.0)) > 0:
            return name
    return None
