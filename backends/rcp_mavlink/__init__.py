"""MAVLink vehicles: drones, planes, rovers and boats; `rcp_mavlink_sim` simulates them.

Importing this package is cheap; pymavlink is imported when a backend is opened.
"""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind
from rcp_mavlink.backend import MavlinkBackend, open_mavlink
from rcp_mavlink.config import MavlinkConfig, TwinConfig

__all__ = ["MavlinkBackend", "MavlinkConfig", "TwinConfig", "open_mavlink", "rcp_backends"]


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Connect MAVLink vehicles."""
    text, needs = "MAVLink vehicles.", ("pymavlink", "fastcrc")
    return [BackendKind("mavlink", MavlinkConfig, open_mavlink, text, needs)]
