"""What a browser wants to hear before it shows an answer to a page of another origin."""

from __future__ import annotations

from typing import Any

from rcp_asgi.request_head import METHODS
from rcp_kernel.asgi import Scope, Send, header

__all__ = ["allowing", "is_preflight", "preflight"]

_EXPOSED = b"location, etag, retry-after, content-range, x-rcp-id"


def is_preflight(scope: Scope) -> bool:
    """Tell whether a browser asks for leave."""
    return (
        scope["method"] == "OPTIONS" and header(scope, b"access-control-request-method") is not None
    )


async def preflight(scope: Scope, send: Send, origin: str) -> None:
    """Give leave for whatever headers the page wants to send."""
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
    """Add to a response that pages of `origin` may read it."""

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
