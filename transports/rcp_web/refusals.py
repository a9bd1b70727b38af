"""How a request that failed is answered."""

from __future__ import annotations

from typing import NamedTuple

from rcp_kernel.asgi import JSON, Headers, Scope, refusal_headers
from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure

__all__ = ["Refusal", "envelope", "headers_of", "not_taken"]


class Refusal(NamedTuple):
    """A body, and headers beside those of the status."""

    body: bytes
    media: bytes = JSON
    headers: tuple[tuple[bytes, bytes], ...] = ()


def envelope(_: Scope, error: RcpError) -> Refusal:
    """Refuse with an envelope in JSON."""
    return Refusal(encode_reply(failure(error, "error"), Encoding.JSON))


def not_taken(path: str, method: str, methods: list[str]) -> UnsupportedOperation:
    """Return the error for a method that a path does not support."""
    return UnsupportedOperation(
        f"{path} does not support {method}",
        remedy=f"Use {' or '.join(methods)}.",
        details={"allowed": methods},
    )


def headers_of(error: RcpError) -> Headers:
    """Return the headers of an error's status, among them what `not_taken` allows."""
    headers = refusal_headers(error)
    if error.http == 405 and error.details is not None:
        headers.append((b"allow", ", ".join(error.details["allowed"]).encode()))
    return headers
