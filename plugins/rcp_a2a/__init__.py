"""Agents over A2A: a card, JSON-RPC and REST; a message is a plan, a task is its execution."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from rcp_a2a.config import A2aConfig, check
from rcp_gateway.api import GatewayConfig
from rcp_gateway.client_api import ClientApi
from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.errors import ConfigError

__all__ = ["A2aConfig", "open_a2a", "rcp_adapters"]


@asynccontextmanager
async def open_a2a(config: A2aConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Mount the agent in the listener while entered.

    :raises ConfigError: a key or CA cannot be read, or a network in `push` is invalid.
    """
    # The SDK takes half a second to import: only gateways that use A2A need it, and robots can
    # connect meanwhile. Its tracing spans would complain about streams that end in another context.
    os.environ.setdefault("OTEL_INSTRUMENTATION_A2A_SDK_ENABLED", "false")
    loaded = await asyncio.to_thread(import_module, "rcp_a2a.app_lifespan")
    async with loaded.serving(config, client_api) as facts:
        yield facts


def _check(config: A2aConfig, gateway: GatewayConfig) -> None:
    check(config)
    served = gateway.transports.get("asgi", {}).get("port", 8080)
    if config.grpc is not None and config.grpc.port == served != 0:
        raise ConfigError(
            f"[plugins.a2a.grpc]: `grpc.port`: {served} is the port of [transports.asgi]: write another"
        )


def _lacks(config: A2aConfig) -> str | None:
    if config.grpc is None or find_spec("grpc") is not None:
        return None
    return (
        "[plugins.a2a.grpc]: `grpc` needs a library: No module named 'grpc'; try: "
        "pip install 'rcp-gateway[grpc]'"
    )


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide A2A."""
    needs = ("a2a", "starlette", "google.protobuf", "httpx", "cryptography", "jwt")
    text = __doc__ or ""
    return [AdapterKind("a2a", A2aConfig, open_a2a, text, needs, check=_check, lacks=_lacks)]
