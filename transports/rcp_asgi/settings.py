"""State shared by the connections of one listener."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from rcp_asgi.config import AsgiConfig
from rcp_asgi.proxies import Proxies
from rcp_gateway.client_api import ClientApi

__all__ = ["Settings"]


@dataclass(frozen=True, slots=True)
class Settings:
    """The configuration, the gateway's limits, and the callbacks for the shutdown."""

    config: AsgiConfig
    client_api: ClientApi
    proxies: Proxies
    closing: set[Callable[[], None]] = field(default_factory=set[Callable[[], None]])
    """Called when the listener closes: the `rcp.closing` extension of endless responses."""
