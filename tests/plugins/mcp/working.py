"""Actions of a robot under the names that the suite's scenarios for tasks want. For tests only."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import msgspec
from mcp import types

from plugins.mcp.rig import Robot
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress
from rcp_kernel.types import quantity
from rcp_mcp import McpConfig
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.command_tools import CommandTools
from rcp_mcp.logs import Logs
from rcp_mcp.offers import Context, Offer, Outcome
from rcp_mcp.tree import Tree

TOOLS = {
    "slow_compute": "action-slow_compute",
    "failing_job": "action-failing_job",
    "protocol_error_job": "action-protocol_error_job",
}


class Work(msgspec.Struct, frozen=True):
    """How long to work."""

    seconds: quantity("s") = 0.0  # pyright: ignore[reportInvalidTypeForm]
    label: str = ""


class Worker(Robot):
    """Works for some time, fails, or breaks."""

    def __init__(self, host: Host) -> None:
        super().__init__(host)
        self.add(
            Resource(
                name="action/slow_compute",
                description="Takes a while.",
                input=Work | None,
                output=str,
                policy="parallel",
            ),
            Resource(name="action/failing_job", description="Fails.", policy="parallel"),
            Resource(name="action/protocol_error_job", description="Breaks.", policy="parallel"),
        )

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        match name:
            case "action/slow_compute":
                await asyncio.sleep(0 if value is None else value.seconds)
                return "computed"
            case "action/failing_job":
                await asyncio.sleep(0.2)
                raise DeviceRejected("it never works")
            case "action/protocol_error_job":
                await asyncio.sleep(0.2)
                raise ZeroDivisionError("a bug")
            case _:
                return await super().execute(name, value, progress)


class Named(Offer):
    """The tools of these actions once more, under other names."""

    def __init__(self, client_api: ClientApi) -> None:
        config = McpConfig(tools=("/**",))
        self._tree = Tree(
            config,
            client_api,
            CommandTools(config, client_api, Catalogue(config, client_api), Logs()),
        )

    async def tools(self, ctx: Context) -> Sequence[types.Tool]:
        known = {tool.name: tool for tool in await self._tree.tools(ctx)}
        named = [known[real].model_copy(update={"name": name}) for name, real in TOOLS.items()]
        schema = {"type": "object", "properties": {"name": {"type": "string"}}}
        return [*named, types.Tool(name="greet", description="Greets.", input_schema=schema)]

    async def call(self, ctx: Context, params: types.CallToolRequestParams) -> Outcome | None:
        if params.name == "greet":
            text = f"Hello, {(params.arguments or {})['name']}!"
            return types.CallToolResult(content=[types.TextContent(type="text", text=text)])
        real = TOOLS.get(params.name)
        if real is None:
            return None
        return await self._tree.call(ctx, params.model_copy(update={"name": real}))
