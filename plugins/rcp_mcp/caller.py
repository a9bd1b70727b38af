"""The caller: the session of a request, and the capabilities of its client."""

from __future__ import annotations

from typing import Any, cast

from rcp_gateway.api import Session
from rcp_mcp.offers import Context

__all__ = ["SESSION", "TASKS", "asks_people", "modern", "session_of", "takes_tasks"]

SESSION = "rcp.session"
"""Key in the request's scope under which the endpoint stores the session."""
TASKS = "io.modelcontextprotocol/tasks"
_FIRST_MODERN = "2026-07-28"


def session_of(ctx: Context) -> Session:
    """Return the session of a request."""
    request: Any = ctx.request
    return cast("Session", request.scope[SESSION])


def modern(ctx: Context) -> bool:
    """Return whether a client uses a protocol version without sessions."""
    return ctx.protocol_version >= _FIRST_MODERN


def asks_people(ctx: Context) -> bool:
    """Return whether the client can ask its user (elicitation)."""
    capabilities = ctx.session.client_capabilities
    if capabilities is None or capabilities.elicitation is None:
        return False
    asks = capabilities.elicitation
    return asks.form is not None or asks.url is None


def takes_tasks(ctx: Context) -> bool:
    """Return whether the client supports tasks."""
    capabilities = ctx.session.client_capabilities
    extensions: dict[str, Any] | None = None if capabilities is None else capabilities.extensions
    return modern(ctx) and extensions is not None and TASKS in extensions
