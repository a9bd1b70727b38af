"""A vehicle without hardware: an ArduCopter of our own that speaks MAVLink 2 over UDP and TCP.

It needs no gateway: `python -m rcp_mavlink_sim`, or `fly(Vehicle(Options()), …)` on an
event loop of one's own.
"""

from __future__ import annotations

from rcp_mavlink_sim.faults import Faults
from rcp_mavlink_sim.options import Options
from rcp_mavlink_sim.ports import Twin, fly
from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["Faults", "Options", "Twin", "Vehicle", "fly"]
