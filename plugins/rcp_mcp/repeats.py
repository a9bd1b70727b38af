"""Repeated calls: the idempotency key of a call whose client says, or shows, that it repeats it.

MCP has no idempotency key of its own. A request's id is unique only within a session, and a
progress token only while its request runs; clients count both from 0 again after a reconnect.
"""

from __future__ import annotations

import hashlib
from typing import Any

from rcp_kernel.errors import BadRequest
from rcp_kernel.wire import Request
from rcp_mcp.offers import Context
from rcp_mcp.stops import ESTOP, is_hold

__all__ = ["KEY", "with_key"]

KEY = "rcp/idempotency-key"
"""Key of `_meta` in a call with an idempotency key of the client's."""
_LONGEST = 256


def with_key(ctx: Context, request: Request, path: str) -> None:
    """Give a request a key from its call, unless it has one; a stop is always executed.

    :raises BadRequest: the client's key is not a short text.
    """
    if request.idempotency_key is not None or request.dry_run or path == ESTOP or is_hold(path):
        return
    meta: Any = (ctx.params or {}).get("_meta")
    given = meta.get(KEY) if isinstance(meta, dict) else None  # pyright: ignore[reportUnknownMemberType]
    if given is not None:
        if not isinstance(given, str) or not 0 < len(given) <= _LONGEST:
            raise BadRequest(
                f"`_meta` has no valid '{KEY}'",
                remedy=f"Send a text of 1 to {_LONGEST} characters, or none.",
            )
        request.idempotency_key = given
        return
    session = _session(ctx)
    if session is None:
        return
    # With the content: a client that uses ids twice for different calls is not refused.
    text = (session, type(ctx.request_id).__name__, str(ctx.request_id), request.type, path)
    digest = hashlib.sha256("\0".join(text).encode() + b"\0" + bytes(request.body))
    request.idempotency_key = f"mcp-{digest.hexdigest()}"


def _session(ctx: Context) -> str | None:
    request: Any = ctx.request
    return None if request is None else request.headers.get("mcp-session-id")
