"""The adapter at work: catalogue, server and endpoint, mounted in the listener."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

from rcp_kernel.door import Door, Mount
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.commanding import Commanding
from rcp_mcp.config import McpConfig, check
from rcp_mcp.endpoint import WELL_KNOWN, Endpoint, Metadata
from rcp_mcp.journal import Manager
from rcp_mcp.listening import Listening
from rcp_mcp.offers import Offer
from rcp_mcp.server import McpServer
from rcp_mcp.tree import Tree

__all__ = ["open_mcp"]


@asynccontextmanager
async def open_mcp(
    config: McpConfig, door: Door, more: Sequence[Offer] = ()
) -> AsyncGenerator[dict[str, Any]]:
    """Serve the tree, and what `more` offers behind it, through the listener while entered."""
    check(config)
    catalogue = Catalogue(config, door)
    listening = Listening(door, catalogue)
    tree = Tree(config, door, Commanding(config, door, catalogue))
    server = McpServer("RCP gateway", [tree, *more], listening)
    manager = Manager(
        door.outbound,
        server,
        session_idle_timeout=config.idle,
        max_request_body_size=min(config.message, door.limits.message),
        max_sessions=config.sessions,
    )
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(manager.run())
        stack.callback(listening.close)
        for prefix, app in (
            (config.path, Endpoint(config, door, manager)),
            (WELL_KNOWN, Metadata(config, door)),
        ):
            mount = Mount(name="mcp", prefix=prefix, app=app)
            door.mount(mount)
            stack.callback(door.unmount, mount)
        yield {"path": config.path}
