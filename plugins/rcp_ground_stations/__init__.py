"""Ground stations: QGroundControl, Mission Planner or MAVSDK at a vehicle, through the gateway."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl
from rcp_ground_stations.config import GroundStationsConfig

__all__ = ["GroundStationsConfig", "rcp_adapters"]


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide links for ground stations."""
    from rcp_ground_stations.stations import open_stations

    return [
        AdapterKind(
            "ground_stations",
            GroundStationsConfig,
            open_stations,
            __doc__ or "",
            needs=("fastcrc", "pymavlink"),
        )
    ]
