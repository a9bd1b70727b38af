"""Model Context Protocol: the robots as tools and resources for models, at /mcp."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractAsyncContextManager
from importlib.util import find_spec
from typing import Any

from rcp_kernel.door import Door
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.spi import AdapterKind
from rcp_mcp.config import McpConfig

__all__ = ["McpConfig", "rcp_adapters"]

if find_spec("mcp") is None:
    raise ImportError("No module named 'mcp'")


def _open(config: McpConfig, door: Door) -> AbstractAsyncContextManager[dict[str, Any]]:
    """Open the adapter; the SDK takes a second to import, which only who serves it waits for."""
    from rcp_mcp.serving import open_mcp

    return open_mcp(config, door)


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Offer MCP."""
    return [AdapterKind("mcp", McpConfig, _open, __doc__ or "")]
