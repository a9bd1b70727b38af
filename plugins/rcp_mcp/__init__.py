"""Model Context Protocol: the robots as tools and resources for models, at /mcp."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from importlib import import_module
from typing import Any

from rcp_gateway.client_api import ClientApi
from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl
from rcp_mcp.config import McpConfig

__all__ = ["McpConfig", "rcp_adapters"]


@asynccontextmanager
async def _open(config: McpConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Open the adapter.

    The SDK takes half a second to import: only gateways that serve MCP need it, and it is imported
    in a thread, so that robots can connect meanwhile.
    """
    loaded = await asyncio.to_thread(import_module, "rcp_mcp.server_lifespan")
    async with loaded.open_mcp(config, client_api) as facts:
        yield facts


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide MCP."""
    needs = ("mcp", "PIL", "pydantic", "httpx2")
    return [AdapterKind("mcp", McpConfig, _open, __doc__ or "", needs=needs)]
