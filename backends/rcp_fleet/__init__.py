"""A fleet: gateways of robots that dial in over Zenoh, as one tree.

Importing this costs nothing; zenoh is imported when a backend is opened.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from rcp_fleet.config import FleetConfig, check_hub
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import Backend, BackendKind, Host

__all__ = ["FleetConfig", "open_fleet", "rcp_backends"]


@asynccontextmanager
async def open_fleet(config: FleetConfig, host: Host) -> AsyncGenerator[Backend]:
    """Show the gateways of the fleet while entered."""
    from rcp_fleet.backend import open_gateways

    async with open_gateways(config, host) as backend:
        yield backend


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Offer the fleet."""
    text = "Gateways of robots that dial in over Zenoh, as one tree."
    needs = ("zenoh", "cryptography", "jwt")
    return [BackendKind("fleet", FleetConfig, open_fleet, text, needs, check_hub)]
