"""The session API over Zenoh: a gateway that dials out to the routers of its fleet.

Importing this costs nothing; zenoh is imported when the transport is opened.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_gateway.api import GatewayConfig
from rcp_gateway.client_api import ClientApi
from rcp_gateway.client_kinds import TransportKind
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.errors import ConfigError
from rcp_zenoh.config import ZenohConfig
from rcp_zenoh.tls import check_links, check_name

__all__ = ["ZenohConfig", "open_zenoh", "rcp_transports"]


@asynccontextmanager
async def open_zenoh(config: ZenohConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Join the fleet while entered, also if its routers come later."""
    from rcp_zenoh.transport import joined

    async with joined(config, client_api) as facts:
        yield facts


def _check(config: ZenohConfig, _gateway: GatewayConfig) -> None:
    try:
        check_links(config.connect, config.tls)
        check_name(config.gateway, config.tls)
    except ConfigError as error:
        raise ConfigError(f"[transports.zenoh]: {error}") from None


@hookimpl
def rcp_transports() -> Iterable[TransportKind]:
    """Provide Zenoh."""
    text = "Joins a fleet: the gateway dials out to routers, over Zenoh."
    needs = ("zenoh", "cryptography")
    return [TransportKind("zenoh", ZenohConfig, open_zenoh, text, check=_check, needs=needs)]
