"""Keys that end while a test looks on."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import msgspec

from rcp_gateway.server import Server
from rcp_kernel.config.identity import KeyConfig

__all__ = ["brief_key"]

_KEY = "key-that-ends-soon"
_LIFE = timedelta(seconds=3)  # for what a slow machine has to begin before it ends


def brief_key(server: Server) -> str:
    """Give a running gateway an operator's key of tenant `alpha` that ends in a moment, and return it."""
    ends = (datetime.now(UTC) + _LIFE).isoformat()
    key = KeyConfig(name="brief", role="operator", tenants=("alpha",), key=_KEY, expires=ends)
    config = server.gateway.settings.config
    server.gateway.reconfigure(msgspec.structs.replace(config, keys=(*config.keys, key)))
    return _KEY
