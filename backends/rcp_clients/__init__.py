"""What clients offer: services and actions of web pages and scripts, in a tenant's tree."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_clients.backend import ClientsBackend, open_clients
from rcp_clients.config import ClientsConfig
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind

__all__ = ["CLIENTS", "ClientsBackend", "ClientsConfig", "open_clients", "rcp_backends"]

CLIENTS = BackendKind(
    "clients", ClientsConfig, open_clients, "Services and actions that clients offer."
)


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Provide what clients offer."""
    return [CLIENTS]
