"""Log messages to clients that want them: what became of their commands.

Version 2026-07-28 deprecates them, and sends them only with a request that asks for them.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from typing import Any

from mcp import types
from mcp.shared.exceptions import MCPDeprecationWarning

from rcp_mcp.caller import modern
from rcp_mcp.offers import Context

__all__ = ["Logs"]

_LEVELS: tuple[types.LoggingLevel, ...] = (
    "debug", "info", "notice", "warning", "error", "critical", "alert", "emergency",
)  # fmt: skip
_SESSIONS = 1000


class Logs:
    """The levels that the sessions of older clients have set."""

    def __init__(self) -> None:
        self._levels: OrderedDict[str, types.LoggingLevel] = OrderedDict()

    async def set_level(
        self, ctx: Context, params: types.SetLevelRequestParams
    ) -> types.EmptyResult:
        """Set the lowest level that a session receives; before that it receives none."""
        if (session := _session(ctx)) is not None:
            self._levels[session] = params.level
            self._levels.move_to_end(session)
            if len(self._levels) > _SESSIONS:
                self._levels.popitem(last=False)
        return types.EmptyResult()

    async def send(self, ctx: Context, level: types.LoggingLevel, data: dict[str, Any]) -> None:
        """Send a message with the response to a request, if its client wants it."""
        if not modern(ctx):
            least = self._levels.get(_session(ctx) or "")
            if least is None or _LEVELS.index(level) < _LEVELS.index(least):
                return
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MCPDeprecationWarning)
            await ctx.session.send_log_message(
                level, data, logger="rcp", related_request_id=ctx.request_id
            )


def _session(ctx: Context) -> str | None:
    request: Any = ctx.request
    return None if request is None else request.headers.get("mcp-session-id")
