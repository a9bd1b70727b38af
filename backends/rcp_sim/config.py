"""The configuration of one simulated rover; every key has a default."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import ConfigError
from rcp_sim.messages import Box, FaultSpec
from rcp_sim.planner import MARGIN
from rcp_sim.world import WAREHOUSE, Rect, World

__all__ = ["BatteryConfig", "Hall", "SimConfig", "Start"]

Hertz = Annotated[float, Meta(ge=1, le=1000, extra_json_schema={"unit": "Hz"})]
SlowHertz = Annotated[float, Meta(ge=1, le=50, extra_json_schema={"unit": "Hz"})]
Metres = Annotated[float, Meta(ge=-1000, le=1000, extra_json_schema={"unit": "m"})]
HallSize = Annotated[float, Meta(ge=2, le=100, extra_json_schema={"unit": "m"})]


class Start(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Initial pose of the rover, which is also the position of its charger."""

    x: Metres = 0.0
    y: Metres = 0.0
    yaw: Annotated[float, Meta(ge=-6.2832, le=6.2832, extra_json_schema={"unit": "rad"})] = 0.0


class Hall(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A custom world: a hall centred on the origin, with boxes in it."""

    width: HallSize = 40.0
    """Along x, m."""
    height: HallSize = 40.0
    """Along y, m."""
    obstacles: Annotated[tuple[Box, ...], Meta(max_length=32)] = ()


class BatteryConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rover's battery."""

    capacity: Annotated[float, Meta(ge=0.01, le=10_000, extra_json_schema={"unit": "W.h"})] = 60.0
    charge: Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})] = 0.95


class SimConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One rover in one world."""

    seed: Annotated[int, Meta(ge=0)] = 1
    """Runs with the same seed, commands and ticks are identical."""
    rate: Hertz = 50.0
    """Ticks per second; pose, velocity, odometry and IMU are sent at each tick."""
    scan_rate: SlowHertz = 10.0
    camera_rate: SlowHertz = 4.0
    points_rate: SlowHertz = 5.0
    frames_rate: SlowHertz = 20.0
    """Rate of the transforms and joint states."""
    battery_rate: SlowHertz = 1.0
    beams: Annotated[int, Meta(ge=8, le=4096)] = 360
    """Number of laser beams over the full circle."""
    scan_range: Annotated[float, Meta(ge=1, le=100, extra_json_schema={"unit": "m"})] = 12.0
    map_resolution: Annotated[float, Meta(ge=0.02, le=1, extra_json_schema={"unit": "m"})] = 0.02
    noise: Annotated[float, Meta(ge=0, le=10, extra_json_schema={"unit": "1"})] = 1.0
    """Scale of the sensors' noise and drift; 0 disables both."""
    time_scale: Annotated[float, Meta(ge=0.1, le=100, extra_json_schema={"unit": "1"})] = 1.0
    """Simulated seconds per real second."""
    start: Start = Start()
    world: Literal["warehouse", "empty"] | Hall = "warehouse"
    battery: BatteryConfig = BatteryConfig()
    faults: tuple[FaultSpec, ...] = ()
    """Faults active from the start."""

    def make_world(self) -> World:
        """Build the world.

        :raises ConfigError: the start is not clear of walls and boxes.
        """
        match self.world:
            case "warehouse":
                world = WAREHOUSE
            case "empty":
                world = World(40.0, 40.0)
            case Hall(width=width, height=height, obstacles=boxes):
                world = World(width, height, [Rect.of(box) for box in boxes])
        if world.clearance(self.start.x, self.start.y) <= MARGIN:
            raise ConfigError(
                f"start ({self.start.x}, {self.start.y}) is within {MARGIN} m of an obstacle or wall"
            )
        return world
