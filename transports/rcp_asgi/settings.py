"""What the connections of one listener share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from rcp_asgi.config import AsgiConfig
from rcp_asgi.proxies import Proxies
from rcp_kernel.client_api import ClientApi

__all__ = ["Settings"]


@dataclass(frozen=True, slots=True)
class Settings:
    """The configuration, the gateway's limits, and who wants to know of the end."""

    config: AsgiConfig
    client_api: ClientApi
    proxies: Proxies
    closing: set[Callable[[], None]] = field(default_factory=set[Callable[[], None]])
    """Called when the listener closes: `scope["extensions"]["rcp.closing"]` of endless responses."""
