"""The rover's sensors: the true state with noise and drift, all derived from the seed."""

from __future__ import annotations

import math
import random

from rcp_kernel.clock import iso
from rcp_kernel.types import (
    AngularVelocity,
    LaserScan,
    LinearAcceleration,
    LinearVelocity,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Twist,
)
from rcp_profiles.messages import TwistStamped
from rcp_sim.config import SimConfig
from rcp_sim.messages import Battery, Imu, OccupancyGrid, Odometry
from rcp_sim.raycast import Fan
from rcp_sim.rover import Rover
from rcp_sim.simulation import Simulation

__all__ = ["Sensors", "Wheels", "battery", "heading", "pose", "velocity"]

GRAVITY = 9.80665  # m/s2
RANGE_MIN = 0.05  # m


def heading(yaw: float) -> Quaternion:
    """Return the orientation for a yaw in radians, counter-clockwise."""
    return Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def pose(rover: Rover, now: int) -> PoseStamped:
    """Return the rover's pose on the map; localisation is exact."""
    return PoseStamped(Point(rover.x, rover.y, 0.0), heading(rover.yaw), "map", iso(now))


def velocity(rover: Rover, now: int) -> TwistStamped:
    """Return the rover's velocity, as its wheels measure it."""
    linear, angular = LinearVelocity(rover.v), AngularVelocity(0.0, 0.0, rover.w)
    return TwistStamped(linear, angular, timestamp=iso(now))


def battery(sim: Simulation, now: int) -> Battery:
    """Return the state of the battery."""
    pack = sim.pack
    return Battery(
        round(pack.voltage, 4),
        round(pack.current, 4),
        round(pack.charge, 6),
        round(pack.energy, 5),
        pack.charging,
        iso(now),
    )


class Wheels:
    """Dead reckoning with small errors of the wheel radius and the track width."""

    def __init__(self, rover: Rover, seed: int, noise: float) -> None:
        draw = random.Random(f"{seed} wheels")  # noqa: S311 - a simulation, not a secret
        self._grow = 1 + draw.gauss(0, 0.005) * noise
        self._twist = 1 + draw.gauss(0, 0.01) * noise
        self._rover = rover
        self.zero()

    def zero(self) -> None:
        """Restart at the origin."""
        self.x = self.y = self.yaw = 0.0
        self._path, self._turned = self._rover.path, self._rover.turned

    def follow(self, rover: Rover) -> None:
        """Integrate the wheels since the last call; a teleported rover adds no motion."""
        if rover is not self._rover:
            self._rover = rover
        else:
            distance = (rover.path - self._path) * self._grow
            turn = (rover.turned - self._turned) * self._twist
            self.x += distance * math.cos(self.yaw + turn / 2)
            self.y += distance * math.sin(self.yaw + turn / 2)
            self.yaw = math.remainder(self.yaw + turn, 2 * math.pi)
        self._path, self._turned = rover.path, rover.turned


class Sensors:
    """Generates the rover's sensor values, each with its own noise source."""

    def __init__(self, config: SimConfig, rover: Rover) -> None:
        seed, self._noise = config.seed, config.noise
        self.wheels = Wheels(rover, seed, config.noise)
        self._imu = random.Random(f"{seed} imu")  # noqa: S311
        self._bias = self._imu.gauss(0, 0.002) * config.noise
        laser = random.Random(f"{seed} laser")  # noqa: S311
        self._laser = laser
        self._ripple = [laser.gauss(0, 0.008) * config.noise for _ in range(config.beams + 1024)]
        """Precomputed range noise, read from a random offset: new noise would double the cost."""
        step = 2 * math.pi / config.beams
        self._fan = Fan([-math.pi + i * step for i in range(config.beams)])
        self._step = step
        self._reach = config.scan_range
        self._resolution = config.map_resolution

    def odometry(self, rover: Rover, now: int) -> Odometry:
        """Return the pose and velocity by dead reckoning."""
        wheels = self.wheels
        return Odometry(
            Pose(Point(wheels.x, wheels.y, 0.0), heading(wheels.yaw)),
            Twist(LinearVelocity(rover.v), AngularVelocity(0.0, 0.0, rover.w)),
            timestamp=iso(now),
        )

    def imu(self, rover: Rover, now: int) -> Imu:
        """Return an inertial measurement."""
        gauss, noise = self._imu.gauss, self._noise
        return Imu(
            heading(rover.yaw),
            AngularVelocity(0.0, 0.0, rover.w + self._bias + gauss(0, 0.003) * noise),
            LinearAcceleration(
                rover.accel + gauss(0, 0.02) * noise,
                rover.v * rover.w + gauss(0, 0.02) * noise,
                GRAVITY + gauss(0, 0.02) * noise,
            ),
            timestamp=iso(now),
        )

    def scan(self, sim: Simulation, now: int) -> LaserScan:
        """Return one sweep of the range finder; `Infinity` if nothing is in range."""
        rover = sim.rover
        ranges, _ = self._fan.cast(sim.world.faces, rover.x, rover.y, rover.yaw, self._reach)
        start = self._laser.randrange(1024)
        noisy = zip(ranges, self._ripple[start : start + len(ranges)], strict=True)
        low, high = RANGE_MIN, self._reach
        return LaserScan(
            -math.pi,
            self._step,
            low,
            high,
            [r if r > high else round(min(high, max(low, r + n)), 3) for r, n in noisy],
            "laser",
            iso(now),
        )

    def map(self, sim: Simulation, now: int) -> OccupancyGrid:
        """Return the map of the world."""
        columns, rows, data = sim.world.grid(self._resolution)
        left, bottom, _, _ = sim.world.bounds
        origin = Pose(Point(left, bottom, 0.0))
        return OccupancyGrid(self._resolution, columns, rows, origin, data, "map", iso(now))
