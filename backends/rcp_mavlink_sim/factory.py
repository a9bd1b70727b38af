"""The vehicle of given options, and its connections."""

from __future__ import annotations

from collections.abc import Callable

from rcp_mavlink_sim.ground_station import GroundStation
from rcp_mavlink_sim.options import Options
from rcp_mavlink_sim.px4.ground_station import Px4GroundStation
from rcp_mavlink_sim.px4.vehicle import Px4Vehicle
from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["station_of", "vehicle_of"]


def vehicle_of(options: Options) -> Vehicle:
    """Make a vehicle with the autopilot of its options."""
    return (Px4Vehicle if options.vehicle == "px4" else Vehicle)(options)


def station_of(vehicle: Vehicle, send_bytes: Callable[[bytes], None]) -> GroundStation:
    """Make the connection of a ground station, which is sent one frame at a time."""
    make = Px4GroundStation if isinstance(vehicle, Px4Vehicle) else GroundStation
    return make(vehicle, send_bytes)
