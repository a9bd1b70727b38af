"""rosbridge v2: web pages and scripts made for rosbridge_suite, at /rosbridge or on a port of its own."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl
from rcp_rosbridge.config import RosbridgeConfig
from rcp_rosbridge.endpoint import open_rosbridge

__all__ = ["ROSBRIDGE", "RosbridgeConfig", "open_rosbridge", "rcp_adapters"]

ROSBRIDGE = AdapterKind("rosbridge", RosbridgeConfig, open_rosbridge, __doc__ or "")


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide rosbridge."""
    return [ROSBRIDGE]
