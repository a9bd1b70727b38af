"""A simulated vehicle with ArduPilot or PX4 that speaks MAVLink 2 over UDP and TCP.

It does not need a gateway: run `python -m rcp_mavlink_sim`, or `fly(vehicle_of(Options()), …)` on an
event loop.
"""

from __future__ import annotations

from rcp_mavlink_sim.factory import vehicle_of
from rcp_mavlink_sim.faults import Faults
from rcp_mavlink_sim.options import Options
from rcp_mavlink_sim.ports import Twin, fly
from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["Faults", "Options", "Twin", "Vehicle", "fly", "vehicle_of"]
