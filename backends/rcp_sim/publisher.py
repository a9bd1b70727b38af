"""What the rover publishes, and when: one physics step per tick serves every sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rcp_kernel.spi import Host
from rcp_kernel.types import AngularVelocity, LinearVelocity, Twist
from rcp_sim.body import DESCRIPTION, joints, transforms
from rcp_sim.camera import picture
from rcp_sim.config import SimConfig
from rcp_sim.depth import Depth
from rcp_sim.faults import FaultBoard
from rcp_sim.sensors import Sensors, battery, pose, velocity
from rcp_sim.simulation import Simulation

__all__ = ["Publisher"]

_SLOWEST = 1.0  # Hz, minimum rate of a watched sensor, so that it does not look stale


class _Rhythm:
    """A sensor with its own rate, synchronised with the ticks."""

    def __init__(self, rate: float, *, watched: bool) -> None:
        self.rate = rate
        self.wanted: list[float | None] = []
        """The requested rates; None is the maximum."""
        self._watched = watched
        self._next = 0.0

    def due(self, uptime: float) -> bool:
        """Return whether the next value is due, and count it as sent."""
        if self._watched and not self.wanted:
            return False
        if uptime < self._next - 1e-9:
            return False
        rate = self.rate
        if self.wanted and None not in self.wanted:
            rate = min(rate, max(_SLOWEST, *(wish for wish in self.wanted if wish is not None)))
        self._next += 1 / rate
        if self._next <= uptime:
            self._next = uptime + 1 / rate
        return True

    def restart(self) -> None:
        """Send the next value at once."""
        self._next = -math.inf


class Publisher:
    """Steps the simulation and passes its values to the host."""

    def __init__(self, config: SimConfig, host: Host, sim: Simulation, faults: FaultBoard) -> None:
        self._host = host
        self._sim = sim
        self._faults = faults
        self.sensors = Sensors(config, sim.rover)
        self._depth = Depth(config.seed, config.noise)
        self._dt = config.time_scale / config.rate
        self._live: tuple[tuple[str, Callable[[int], Any]], ...] = (
            ("sensor/pose", lambda now: pose(sim.rover, now)),
            ("sensor/velocity", lambda now: velocity(sim.rover, now)),
            ("sensor/odometry", lambda now: self.sensors.odometry(sim.rover, now)),
            ("sensor/imu", lambda now: self.sensors.imu(sim.rover, now)),
        )
        self._timed: tuple[tuple[str, Callable[[int], Any], _Rhythm], ...] = (
            ("sensor/scan", self._scan, _Rhythm(config.scan_rate, watched=True)),
            ("sensor/camera", self._picture, _Rhythm(config.camera_rate, watched=True)),
            ("sensor/points", self._cloud, _Rhythm(config.points_rate, watched=True)),
            ("sensor/transforms", self._frames, _Rhythm(config.frames_rate, watched=True)),
            ("sensor/joint_states", self._joints, _Rhythm(config.frames_rate, watched=True)),
            ("sensor/battery", self._battery, _Rhythm(config.battery_rate, watched=False)),
        )
        self._makers: dict[str, Callable[[int], Any]] = {
            **dict(self._live),
            **{name: make for name, make, _ in self._timed},
            "sensor/map": self._map,
            "actuator/cmd_vel": lambda _: self._velocity(),
            "param/speed_limit": lambda _: sim.limit,
            "param/robot_description": lambda _: DESCRIPTION,
        }
        self._shown: dict[str, Any] = {}
        """Values sent on change, as last sent."""

    def tick(self, uptime: float, now: int) -> None:
        """Advance by one period and send what is due; `uptime` is in real seconds."""
        self._sim.step(self._dt)
        self.sensors.wheels.follow(self._sim.rover)
        self.send(uptime, now)

    def send(self, uptime: float, now: int) -> None:
        """Send what is due, except what a fault suppresses."""
        host, faults = self._host, self._faults
        if faults.link_lost:
            return
        any_fault = bool(faults.active)
        for name, make in self._live:
            if not (any_fault and faults.stopped(name)):
                host.publish(name, make(now), now)
        for name, make, rhythm in self._timed:
            if rhythm.due(uptime) and not faults.stopped(name):
                host.publish(name, make(now), now)
        for name, state in self._states().items():
            if self._shown.get(name) != state and not faults.stopped(name):
                self._shown[name] = state
                host.publish(name, self._makers[name](now), now)

    def _states(self) -> dict[str, Any]:
        sim = self._sim
        return {
            "actuator/cmd_vel": sim.velocity,
            "param/speed_limit": sim.limit,
            "param/robot_description": DESCRIPTION,
            "sensor/map": sim.world,
        }

    def taken(self, name: str) -> Any:
        """Return the value in effect after a write; the gateway publishes it."""
        self._shown[name] = self._states()[name]
        return self.make(name, 0)

    def event(self, name: str, event: Any, now: int) -> None:
        """Send an event, unless the link is down."""
        if not self._faults.link_lost:
            self._host.publish(name, event, now)

    def make(self, name: str, now: int) -> Any:
        """Return a current value of a sensor or setting; None if it has none."""
        maker = self._makers.get(name)
        return None if maker is None else maker(now)

    @contextmanager
    def watched(self, name: str, rate: float | None) -> Generator[None]:
        """Run a sensor while entered that is only simulated while watched."""
        rhythm = next((r for sensor, _, r in self._timed if sensor == name), None)
        if rhythm is None:
            yield
            return
        rhythm.wanted.append(rate)
        if len(rhythm.wanted) == 1:
            rhythm.restart()
        try:
            yield
        finally:
            rhythm.wanted.remove(rate)

    def _velocity(self) -> Twist:
        """Return the commanded velocity as the actuator's value."""
        v, w = self._sim.velocity
        return Twist(LinearVelocity(v), AngularVelocity(0.0, 0.0, w))

    def _scan(self, now: int) -> Any:
        return self.sensors.scan(self._sim, now)

    def _picture(self, now: int) -> Any:
        return picture(self._sim, now)

    def _cloud(self, now: int) -> Any:
        return self._depth.cloud(self._sim, now)

    def _frames(self, now: int) -> Any:
        return transforms(self._sim.rover, self.sensors.wheels, now)

    def _joints(self, now: int) -> Any:
        return joints(self._sim.rover, now)

    def _battery(self, now: int) -> Any:
        return battery(self._sim, now)

    def _map(self, now: int) -> Any:
        return self.sensors.map(self._sim, now)
