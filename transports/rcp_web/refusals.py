"""Error responses."""

from __future__ import annotations

from typing import NamedTuple

from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure
from rcp_web.asgi import JSON, Headers, Scope, refusal_headers

__all__ = ["NotTaken", "Refusal", "envelope", "headers_of"]


class Refusal(NamedTuple):
    """A body, and headers in addition to those of the status."""

    body: bytes
    media: bytes = JSON
    headers: tuple[tuple[bytes, bytes], ...] = ()


class NotTaken(UnsupportedOperation):
    """A path does not support the method; `methods` are those that it supports."""

    def __init__(self, path: str, method: str, methods: list[str]) -> None:
        super().__init__(
            f"{path} does not support {method}",
            remedy=f"Use {' or '.join(methods)}.",
            details={"allowed": methods},
        )
        self.methods = methods


def envelope(_: Scope, error: RcpError) -> Refusal:
    """Return an error as an envelope in JSON."""
    return Refusal(encode_reply(failure(error, "error"), Encoding.JSON))


def headers_of(error: RcpError) -> Headers:
    """Return the headers of an error's status."""
    headers = refusal_headers(error)
    if isinstance(error, NotTaken):
        headers.append((b"allow", ", ".join(error.methods).encode()))
    return headers
