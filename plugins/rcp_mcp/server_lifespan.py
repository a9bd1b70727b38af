"""The running adapter: catalogue, server and endpoint, mounted in the listener."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

from rcp_gateway.client_api import ClientApi, Mount
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.command_tools import CommandTools
from rcp_mcp.config import McpConfig, check
from rcp_mcp.endpoint import WELL_KNOWN, Endpoint, Metadata
from rcp_mcp.journal import Manager
from rcp_mcp.listeners import ListenerRegistry
from rcp_mcp.logs import Logs
from rcp_mcp.offers import Offer
from rcp_mcp.server import McpServer
from rcp_mcp.tree import Tree

__all__ = ["open_mcp"]


@asynccontextmanager
async def open_mcp(
    config: McpConfig, client_api: ClientApi, more: Sequence[Offer] = ()
) -> AsyncGenerator[dict[str, Any]]:
    """Serve the tree, followed by the offers in `more`, through the listener while entered."""
    check(config)
    catalogue = Catalogue(config, client_api)
    listening = ListenerRegistry(client_api, catalogue, config.subscriptions)
    logs = Logs()
    tree = Tree(config, client_api, CommandTools(config, client_api, catalogue, logs))
    server = McpServer("RCP gateway", [tree, *more], listening, logs, config.page)
    manager = Manager(
        client_api.outbound,
        server,
        session_idle_timeout=config.idle,
        max_request_body_size=min(config.message, client_api.limits.message),
        max_sessions=config.sessions,
    )
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(manager.run())
        stack.callback(listening.close)
        for prefix, app in (
            (config.path, Endpoint(config, client_api, catalogue, manager)),
            (WELL_KNOWN, Metadata(config, client_api)),
        ):
            mount = Mount(name="mcp", prefix=prefix, app=app)
            client_api.mount(mount)
            stack.callback(client_api.unmount, mount)
        yield {"path": config.path}
