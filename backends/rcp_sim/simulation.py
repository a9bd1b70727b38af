"""The whole rover without a gateway: world, body, battery, controller, stepped explicitly.

It does not wait, read the clock or draw random numbers, so the same commands at the same ticks
give the same run.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

from rcp_kernel.errors import DeviceRejected, ModeForbids
from rcp_sim.battery import LOW, Pack
from rcp_sim.config import SimConfig
from rcp_sim.controller import Follower
from rcp_sim.floor import Floor
from rcp_sim.messages import TOP_SPEED, Box
from rcp_sim.planner import MARGIN
from rcp_sim.rover import RADIUS, Rover
from rcp_sim.world import World

__all__ = ["DEFAULT_LIMIT", "Simulation", "Trip"]

DEFAULT_LIMIT = 1.0  # m/s
_MAX_STEP = 0.02  # s, step of the physics and the controller
_RELEASE = 0.02  # m, spring travel of the bumper

_EMPTY_TEXT = ("The battery is charged again.", "The battery is empty; the motors are off.")
_LOW_TEXT = ("The battery has enough charge again.", "The battery is low: dock soon.")

Happening = tuple[Literal["collision", "battery_low", "battery_empty"], bool, str]


class Trip:
    """One drive to a goal."""

    def __init__(self, task: Literal["move_to", "dock"], follower: Follower, rover: Rover) -> None:
        self.task: Literal["move_to", "dock"] = task
        self.follower = follower
        self.length = follower.remaining(rover)
        """Distance at the start, m."""
        self.odometer = rover.travelled
        self.seconds = 0.0
        self.done = False
        self.failure: str | None = None
        """Why it ended before its goal."""

    def end(self, failure: str | None = None) -> None:
        """Mark as ended, with the reason if it did not arrive."""
        if not self.done:
            self.done, self.failure = True, failure


class Simulation:
    """A rover in its world."""

    def __init__(self, config: SimConfig) -> None:
        self._start = config.start
        self.floor = Floor(config.make_world())
        self.pack = Pack(config.battery.capacity, config.battery.charge)
        self.rover = Rover(self._start.x, self._start.y, self._start.yaw)
        self.limit = DEFAULT_LIMIT
        self.seconds = 0.0
        """Simulated seconds since power-on."""
        self.velocity = (0.0, 0.0)
        """The directly commanded velocities, m/s and rad/s."""
        self.trip: Trip | None = None
        self.happenings: list[Happening] = []
        """Events since the owner last emptied the list."""
        self._hard = False
        self._low = self._empty = False
        self._touching = False

    # Commands

    def drive(self, v: float, w: float) -> tuple[float, float]:
        """Apply a velocity command, limited to the speed limit; return the result.

        A stop ends a trip.

        :raises ModeForbids: a trip is running.
        :raises DeviceRejected: the battery is empty.
        """
        stop = v == 0.0 and w == 0.0
        if self.trip is None:
            if stop:
                self.stop("stopped")
            else:
                self._need_power()
                self.pack.charging = False
                self._hard = False
                self.velocity = (max(-self.limit, min(self.limit, v)), w)
        elif not stop:
            raise ModeForbids(
                f"the rover drives itself: action/{self.trip.task} is running",
                remedy="Cancel the action first, or wait until it ends.",
            )
        else:
            self.stop("stopped by actuator/cmd_vel")
        return self.velocity

    def end_velocity(self) -> None:
        """Brake to rest, unless a trip has replaced the velocity."""
        if self.trip is None:
            self.stop("stopped")

    def stop(self, reason: str, *, hard: bool = False) -> None:
        """Brake to rest; a running trip fails with this reason."""
        self.velocity = (0.0, 0.0)
        self._hard = hard or (self._hard and not self.rover.at_rest)
        if self.trip is not None:
            self.trip.end(reason)
            self.trip = None

    def lose_link(self) -> None:
        """End a trip, as it is no longer supervised; a direct velocity continues."""
        if self.trip is not None:
            self.stop("the link was lost")

    def set_limit(self, limit: float) -> None:
        """Change the speed limit; a faster commanded velocity is reduced to it."""
        self.limit = limit
        v, w = self.velocity
        self.velocity = (max(-limit, min(limit, v)), w)

    def drive_within(self, limit: float, v: float, w: float) -> None:
        """Change the speed limit and apply a velocity, or neither.

        :raises ModeForbids, DeviceRejected: as `drive` does.
        """
        before, self.limit = self.limit, limit
        try:
            self.drive(v, w)
        except BaseException:
            self.limit = before
            raise

    def go(
        self,
        x: float,
        y: float,
        *,
        yaw: float | None = None,
        tolerance: float = 0.1,
        speed: float | None = None,
        task: Literal["move_to", "dock"] = "move_to",
    ) -> Trip:
        """Start a trip to a goal; it replaces a direct velocity.

        :raises ModeForbids: another trip is running.
        :raises DeviceRejected: there is no path to it, or the battery is empty.
        """
        path = self.check_goal(x, y)
        if self.trip is not None:
            raise ModeForbids(
                f"action/{self.trip.task} is running",
                remedy="Cancel it first, or wait until it ends.",
            )
        self._need_power()
        self.velocity = (0.0, 0.0)
        follower = Follower(path, tolerance=tolerance, yaw=yaw, speed=speed or TOP_SPEED)
        self.pack.charging = False
        self._hard = False
        self.trip = Trip(task, follower, self.rover)
        return self.trip

    def check_goal(self, x: float, y: float) -> list[tuple[float, float]]:
        """Return the path to a goal from where the rover is.

        :raises DeviceRejected: there is none.
        """
        if not self.floor.planner.free(x, y):
            inside = self.world.clearance(x, y)
            where = f"{inside:.2f} m from" if inside > 0 else "inside or behind"
            raise DeviceRejected(
                f"goal ({x:g}, {y:g}) is {where} an obstacle or wall",
                remedy=f"Choose a goal at least {MARGIN} m from everything on sensor/map.",
            )
        path = self.floor.planner.find_path((self.rover.x, self.rover.y), (x, y))
        if path is None:
            raise DeviceRejected(f"no path to ({x:g}, {y:g})")
        return path

    def dock(self) -> Trip:
        """Start a trip to the charger at the start position."""
        start = self._start
        return self.go(start.x, start.y, yaw=start.yaw, tolerance=0.05, task="dock")

    def plug_in(self) -> None:
        """Begin to charge; the rover is on its charger."""
        self.pack.charging = True

    # The world

    @property
    def world(self) -> World:
        """The present world; immutable, a change replaces it."""
        return self.floor.world

    def place(self, box: Box) -> str:
        """Place a box and return its name; a running trip is replanned.

        :raises DeviceRejected: it overlaps the rover, is outside, or there are too many boxes.
        """
        name = self.floor.place(box, (self.rover.x, self.rover.y))
        self._replan()
        return name

    def remove(self, name: str) -> None:
        """Remove a box.

        :raises DeviceRejected: there is no box of that name.
        """
        self.floor.remove(name)

    def remove_all(self) -> int:
        """Remove every placed box; return their number."""
        return self.floor.clear()

    def _replan(self) -> None:
        if self.trip is None:
            return
        planner, follower = self.floor.planner, self.trip.follower
        here = (self.rover.x, self.rover.y)
        if all(planner.clear(a, b) for a, b in pairwise([here, *follower.path])):
            return
        path = planner.find_path(here, follower.goal)
        if path is None:
            self.stop("the path is blocked")
        else:
            follower.reroute(path)

    def reset_body(self, *, pose: bool, battery: bool) -> None:
        """Bring the rover to rest; optionally reset its position or its battery.

        :raises DeviceRejected: a box blocks the start.
        """
        if pose and not self.floor.planner.free(self._start.x, self._start.y):
            raise DeviceRejected("a placed box is at the rover's start")
        self.stop("the system was reset", hard=True)
        if pose:
            self.rover = Rover(self._start.x, self._start.y, self._start.yaw)
        if battery:
            self.pack.energy = self.pack.capacity

    # Time

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        steps = max(1, math.ceil(dt / _MAX_STEP - 1e-9))
        for _ in range(steps):
            self._step(dt / steps)

    def _step(self, dt: float) -> None:
        self.seconds += dt
        rover, trip = self.rover, self.trip
        v, w = self.velocity
        if trip is not None:
            trip.seconds += dt
            v, w = trip.follower.command(rover, self.limit, dt)
        elif rover.at_rest and v == 0.0 and w == 0.0:
            rover.accel = 0.0
            self._spend(dt)
            return
        rover.step(dt, v, w, self.world.clearance, hard=self._hard)
        self._feel()
        if trip is not None and trip is self.trip:
            self._judge(trip)
        self._spend(dt)

    def _feel(self) -> None:
        rover = self.rover
        if rover.bumped and (self.trip is not None or not self._touching):
            if not self._touching:
                self.happenings.append(("collision", True, "The bumper touches an obstacle."))
            self._touching = True
            self.stop("blocked: the bumper touches an obstacle", hard=True)
        elif self._touching and self.world.clearance(rover.x, rover.y) > RADIUS + _RELEASE:
            self._touching = False
            self.happenings.append(("collision", False, "The bumper is free again."))

    def _judge(self, trip: Trip) -> None:
        if trip.follower.phase == "done":
            trip.end()
            self.trip = None
        elif trip.follower.stuck:
            self.stop("stuck: no progress for 30 s")

    def _spend(self, dt: float) -> None:
        pack = self.pack
        pack.step(dt, self.rover.v, self.rover.w)
        charge = pack.charge
        if (charge == 0.0) != self._empty and (self._empty is False or charge > LOW):
            self._empty = not self._empty
            self.happenings.append(("battery_empty", self._empty, _EMPTY_TEXT[self._empty]))
            if self._empty:
                self.stop("the battery is empty")
        if (charge < LOW) != self._low and abs(charge - LOW) > 0.001:
            self._low = not self._low
            self.happenings.append(("battery_low", self._low, _LOW_TEXT[self._low]))

    def _need_power(self) -> None:
        if self.pack.energy == 0.0:
            raise DeviceRejected(
                "the battery is empty",
                remedy='Execute service/reset_system with {"battery": true}.',
            )
