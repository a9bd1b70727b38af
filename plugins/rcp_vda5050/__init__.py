"""VDA 5050: mobile robots of any backend take orders of a fleet manager over MQTT."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_gateway.client_api import ClientApi
from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl
from rcp_vda5050.config import VdaConfig

__all__ = ["VdaConfig", "rcp_adapters"]


@asynccontextmanager
async def _open(config: VdaConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    from rcp_vda5050.robots import open_robots  # which needs paho-mqtt

    async with open_robots(config, client_api) as state:
        yield state


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide robots for fleet managers."""
    return [AdapterKind("vda5050", VdaConfig, _open, __doc__ or "", needs=("paho", "httpx"))]
