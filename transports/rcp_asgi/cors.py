"""CORS headers, which browsers require before a page of another origin may read a response."""

from __future__ import annotations

from typing import Any

from rcp_asgi.request_head import METHODS
from rcp_web.asgi import Scope, Send, header

__all__ = ["allowing", "is_preflight", "preflight"]

_EXPOSED = b"location, etag, retry-after, content-range, x-rcp-id"


def is_preflight(scope: Scope) -> bool:
    """Return whether a request is a CORS preflight."""
    return (
        scope["method"] == "OPTIONS" and header(scope, b"access-control-request-method") is not None
    )


async def preflight(scope: Scope, send: Send, origin: str) -> None:
    """Answer a preflight: any header is allowed."""
    wanted = header(scope, b"access-control-request-headers") or b"content-type"
    headers = [
        (b"access-control-allow-origin", origin.encode("latin-1")),
        (b"access-control-allow-methods", METHODS),
        (b"access-control-allow-headers", wanted),
        (b"access-control-max-age", b"600"),
        (b"vary", b"origin"),
    ]
    await send({"type": "http.response.start", "status": 204, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


def allowing(send: Send, origin: str) -> Send:
    """Add the CORS headers for `origin` to a response."""

    async def allowed(message: Any) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [
                *message.get("headers", ()),
                (b"access-control-allow-origin", origin.encode("latin-1")),
                (b"access-control-expose-headers", _EXPOSED),
                (b"vary", b"origin"),
            ]
        await send(message)

    return allowed
