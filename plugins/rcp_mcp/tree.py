"""The robots' tree as an offer: fixed tools, tools of chosen actions and services, resources."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import structlog
from mcp import types
from mcp.shared.exceptions import MCPError

from rcp_gateway.api import Session, to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import InvalidValue, RcpError
from rcp_kernel.wire import error_body
from rcp_mcp.answers import refused
from rcp_mcp.caller import TASKS, session_of
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.command_tools import CommandTools
from rcp_mcp.completion import Completion
from rcp_mcp.config import McpConfig
from rcp_mcp.fixed import FIXED, Fixed
from rcp_mcp.guidance import with_nearest
from rcp_mcp.naming import as_path
from rcp_mcp.offers import Context, Method, Offer, Outcome
from rcp_mcp.prompts import PROMPTS, written
from rcp_mcp.read_tool import ReadTool
from rcp_mcp.read_tools import ReadTools
from rcp_mcp.remedies import in_tools
from rcp_mcp.resources import Resources
from rcp_mcp.robots import RobotTools
from rcp_mcp.urgent import Urgent
from rcp_mcp.watch_tools import WatchTools
from rcp_protocol.plain import is_list, is_map

__all__ = ["Tree"]

log = structlog.get_logger("rcp.mcp")
_ESTOP_TOOL = "system-estop"
_PATHS = frozenset(("path", "paths", "values", "scope"))
"""Arguments that are paths, or maps with paths as keys."""
Handler = Callable[[Context, Session, Any], Awaitable[Outcome]]


def _taken(one: Fixed, arguments: dict[str, Any]) -> Any:
    """Check the arguments of a fixed tool.

    :raises InvalidValue: they do not match its schema.
    """
    try:
        return one.takes.convert(arguments, f"the arguments of {one.tool.name}")
    except InvalidValue as error:
        error.remedy = f"Call `{one.tool.name}` with arguments that fit its input schema."
        raise


def _with_paths(tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
    """Accept `rcp://` addresses wherever a tool takes paths."""
    if tool not in FIXED and tool != _ESTOP_TOOL:
        return arguments
    return {
        name: _as_paths(item, keys=name == "values") if name in _PATHS else item
        for name, item in arguments.items()
    }


def _as_paths(item: Any, *, keys: bool) -> Any:
    if isinstance(item, str):
        return as_path(item)
    if is_list(item):
        return [as_path(one) if isinstance(one, str) else one for one in item]
    if keys and is_map(item):
        return {as_path(name): value for name, value in item.items()}
    return item


class Tree(Offer):
    """The part of the tree that a caller may see."""

    def __init__(self, config: McpConfig, client_api: ClientApi, commanding: CommandTools) -> None:
        self._client_api = client_api
        self._catalogue = commanding.catalogue
        self._commanding = commanding
        self._resources = Resources(config, client_api, self._catalogue)
        self._urgent = Urgent(self._catalogue)
        robots = RobotTools(config, client_api)
        self._completing = Completion(client_api, self._catalogue, robots)
        looking = ReadTools(config, client_api, self._catalogue)
        self._handlers: dict[str, Handler] = {
            "robots": robots.robots,
            "discover": looking.discover,
            "read": ReadTool(config, client_api, self._catalogue).read,
            "status": looking.status,
            "write": commanding.write,
            "write_all": commanding.write_all,
            "execute": commanding.execute,
            "plan": commanding.plan,
            "cancel": commanding.cancel,
            "watch": WatchTools(config, client_api).watch,
        }

    @property
    def catalogue(self) -> Catalogue:
        """The callers' views."""
        return self._catalogue

    def methods(self) -> Sequence[Method]:
        """Serve tasks."""
        return self._commanding.tasks.methods()

    def extensions(self) -> Mapping[str, dict[str, Any]]:
        """Serve tasks."""
        return {TASKS: {}}

    async def tools(self, ctx: Context) -> Sequence[types.Tool]:
        """List the fixed tools that the caller can use, then those of actions and services."""
        session = self._paying(ctx)
        held = {name for one in self._catalogue.all(session) for name in one["operations"]}
        found = [
            one.tool
            for one in FIXED.values()
            if (one.needs is None or one.needs in held)
            and (one.of is None or self._catalogue.find(session, one.of) is not None)
        ]
        typed = self._catalogue.tools(session).values()
        return [*found, *(one.tool for one in typed if one.listed)]

    async def call(self, ctx: Context, params: types.CallToolRequestParams) -> Outcome | None:
        """Call a tool; errors are results that the model can act on."""
        session = session_of(ctx)
        arguments = _with_paths(params.name, params.arguments or {})
        found = await self._called(ctx, session, params.name, arguments)
        if isinstance(found, types.CallToolResult) and found.is_error:
            named = [arguments.get("path"), arguments.get("paths")]
            asked = [one for given in named for one in (given if is_list(given) else [given])]
            known = self._catalogue.all(session)
            return await with_nearest(found, [one for one in asked if isinstance(one, str)], known)
        return found

    async def _called(
        self, ctx: Context, session: Session, name: str, arguments: dict[str, Any]
    ) -> Outcome | None:
        try:
            if (one := FIXED.get(name)) is not None:
                taken = _taken(one, arguments)
                return await self._handlers[name](ctx, session, taken)
            typed = self._urgent.tool(session, name)
            if typed is None:
                return None
            return await self._commanding.call(ctx, session, typed, arguments)
        except MCPError:
            raise
        except RcpError as error:
            return refused(error)
        except Exception as error:
            return refused(to_internal_error(error, tool=name))

    async def resources(self, ctx: Context) -> Sequence[types.Resource]:
        """List what the caller may read."""
        return self._resources.all(self._paying(ctx))

    async def templates(self, ctx: Context) -> Sequence[types.ResourceTemplate]:
        """List the resource templates."""
        return self._resources.templates()

    async def read(
        self, ctx: Context, params: types.ReadResourceRequestParams
    ) -> types.ReadResourceResult | None:
        """Read a complete value."""
        return await self._resources.read(session_of(ctx), params.uri)

    async def prompts(self, ctx: Context) -> Sequence[types.Prompt]:
        """List the prompts for common tasks."""
        return PROMPTS

    async def prompt(
        self, ctx: Context, params: types.GetPromptRequestParams
    ) -> types.GetPromptResult | None:
        """Return a prompt."""
        return written(params.name, params.arguments or {})

    async def complete(
        self, ctx: Context, params: types.CompleteRequestParams
    ) -> types.Completion | None:
        """Complete tenants and paths that the caller may see."""
        return await self._completing.complete(self._paying(ctx), params)

    def _paying(self, ctx: Context) -> Session:
        """Return the session of a request, charging it to the quota.

        :raises MCPError: a quota is exceeded.
        """
        session = session_of(ctx)
        try:
            self._client_api.charge(session)
        except RcpError as error:
            details = {key: item for key, item in error_body(error).items() if key != "trace_id"}
            details["remedy"] = in_tools(details)
            raise MCPError(
                types.INVALID_REQUEST, f"{error.message}. {details['remedy']}", details
            ) from None
        return session
