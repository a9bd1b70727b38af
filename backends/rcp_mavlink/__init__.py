"""MAVLink: drones and what else speaks it; `rcp_mavlink.sim` is one that needs no hardware."""
