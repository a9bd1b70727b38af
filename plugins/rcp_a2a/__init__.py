"""Agents over A2A: a card, JSON-RPC and REST; a message is a plan, a task is its run."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from importlib import import_module
from typing import Any

from rcp_a2a.config import A2aConfig
from rcp_kernel.client_api import ClientApi
from rcp_kernel.client_kinds import AdapterKind
from rcp_kernel.hookspecs import hookimpl

__all__ = ["A2aConfig", "open_a2a", "rcp_adapters"]


@asynccontextmanager
async def open_a2a(config: A2aConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Offer the agent to the listener while entered.

    :raises ConfigError: a key or CA cannot be read, or a network of `push` is none.
    """
    # The official SDK takes half a second to load: only a gateway that speaks A2A pays for it, and
    # the robots that are open by now do not wait meanwhile.
    # Its spans would be of streams that are left from another context, which it complains about.
    os.environ.setdefault("OTEL_INSTRUMENTATION_A2A_SDK_ENABLED", "false")
    loaded = await asyncio.to_thread(import_module, "rcp_a2a.app_lifespan")
    async with loaded.serving(config, client_api) as facts:
        yield facts


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Offer A2A."""
    needs = ("a2a", "starlette")
    return [AdapterKind("a2a", A2aConfig, open_a2a, __doc__ or "", needs=needs)]
