"""Keys that end while a test looks on, by the clock of the gateway that the test puts forward."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import msgspec

from rcp_gateway.server import Server
from rcp_kernel.config.identity import KeyConfig

__all__ = ["LIFE", "brief_key"]

LIFE = 600  # s that the key is good for
_KEY = "key-that-ends-soon"


def brief_key(server: Server) -> str:
    """Give a running gateway an operator's key of tenant `alpha` that ends after `LIFE`, and return it."""
    ends = (datetime.now(UTC) + timedelta(seconds=LIFE)).isoformat()
    key = KeyConfig(name="brief", role="operator", tenants=("alpha",), key=_KEY, expires=ends)
    config = server.gateway.settings.config
    server.gateway.reconfigure(msgspec.structs.replace(config, keys=(*config.keys, key)))
    return _KEY
