"""Sources of tools, resources and prompts, tried in order.

The robots' tree is one; a plugin can add others behind it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, NamedTuple

from mcp import types
from mcp.server.context import HandlerResult, ServerRequestContext
from pydantic import BaseModel

__all__ = ["Context", "Method", "Offer", "Outcome"]

Context = ServerRequestContext[Any, Any]


class Method(NamedTuple):
    """A request besides those for tools, resources and prompts."""

    name: str
    params: type[BaseModel]
    handle: Callable[[Context, Any], Awaitable[HandlerResult]]


Outcome = types.CallToolResult | types.InputRequiredResult | dict[str, Any]


class Offer:
    """An empty offer; subclasses override what they provide. None means: try the next one."""

    def methods(self) -> Sequence[Method]:
        """List additional requests to serve; called once."""
        return ()

    def extensions(self) -> Mapping[str, dict[str, Any]]:
        """Return the supported extensions with their settings; called once."""
        return {}

    def headed(self, tool: str) -> Mapping[str, Any] | None:
        """Return the input schema of a tool whose arguments are also sent as headers."""
        return None

    async def tools(self, ctx: Context) -> Sequence[types.Tool]:
        """List the tools that the caller may use."""
        return ()

    async def call(self, ctx: Context, params: types.CallToolRequestParams) -> Outcome | None:
        """Call a tool."""
        return None

    async def resources(self, ctx: Context) -> Sequence[types.Resource]:
        """List the resources that the caller may read."""
        return ()

    async def templates(self, ctx: Context) -> Sequence[types.ResourceTemplate]:
        """List the resource templates."""
        return ()

    async def read(
        self, ctx: Context, params: types.ReadResourceRequestParams
    ) -> types.ReadResourceResult | types.InputRequiredResult | None:
        """Read a resource."""
        return None

    async def prompts(self, ctx: Context) -> Sequence[types.Prompt]:
        """List the prompts."""
        return ()

    async def prompt(
        self, ctx: Context, params: types.GetPromptRequestParams
    ) -> types.GetPromptResult | types.InputRequiredResult | None:
        """Return a prompt."""
        return None

    async def complete(
        self, ctx: Context, params: types.CompleteRequestParams
    ) -> types.Completion | None:
        """Complete an argument."""
        return None
