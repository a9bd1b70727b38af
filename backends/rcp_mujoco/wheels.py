"""A differential drive: velocities with limits, odometry, and drives to a goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

from rcp_kernel.errors import ConfigError, ModeForbids
from rcp_mujoco.config import WheelsConfig
from rcp_mujoco.joints import Drive
from rcp_mujoco.obstacles import Obstacles
from rcp_mujoco.simulation import Simulation

__all__ = ["Trip", "Wheels"]

_TOLERANCE = 0.05  # m
_HEADING = 0.03  # rad, at the goal
_AIMED = 0.15  # rad, heading error above which it turns on the spot
_TURNING = 3.0  # rad/s for each rad
_PROGRESS = 0.02  # m or rad of progress required …
_PATIENCE = 5.0  # … within so many seconds
_BRAKING = 0.6  # fraction of the acceleration planned for braking
_CREEP = 0.05  # m/s
_LEAN = 0.5  # fraction of the speed in a turn

Phase = Literal["turning", "driving", "aligning", "braking", "done"]


class Trip:
    """A drive to a goal."""

    def __init__(
        self, x: float, y: float, yaw: float | None, *, tolerance: float, speed: float | None
    ) -> None:
        self.x, self.y, self.yaw = x, y, yaw
        self.tolerance, self.speed = tolerance, speed
        self.phase: Phase = "turning"
        self.left = math.inf
        """Distance to the goal, m."""
        self.failure: str | None = None
        self.seconds = 0.0
        self._best = math.inf
        self._best_at = 0.0

    @property
    def over(self) -> bool:
        """Whether it has ended, successfully or not."""
        return self.phase == "done" or self.failure is not None

    def is_stuck(self, left: float) -> bool:
        """Return whether there was no progress for too long."""
        if left < self._best - _PROGRESS:
            self._best, self._best_at = left, self.seconds
        return self.seconds - self._best_at > _PATIENCE

    def enter(self, phase: Phase) -> None:
        """Start another phase, with its own progress."""
        if phase != self.phase:
            self.phase, self._best, self._best_at = phase, math.inf, self.seconds


class Wheels:
    """The base of a robot and its wheels.

    :raises ConfigError: an actuator is not a velocity actuator of a joint.
    :raises DeviceRejected: the model has no such actuators.
    """

    def __init__(self, config: WheelsConfig, simulation: Simulation) -> None:
        self.config = config
        self._simulation = simulation
        self._left = [simulation.drive(name) for name in config.left]
        self._right = [simulation.drive(name) for name in config.right]
        for drive in (*self._left, *self._right):
            if drive.mode != "velocity" or drive.joint is None:
                raise ConfigError(f"wheels: '{drive.name}' is not a velocity actuator of a joint")
        body = simulation.model.body(config.base)
        self._body = int(body.id)
        self._obstacles = Obstacles(simulation, self._body)
        self.limit = config.speed
        self.target = (0.0, 0.0)
        """Commanded speed, m/s, and yaw rate, rad/s."""
        self.trip: Trip | None = None
        self._ramp = (0.0, 0.0)
        self._driving = False
        self.odometry = (0.0, 0.0, 0.0)
        self._turned = self._wheel_angles()

    # Commands

    def drive(self, v: float, w: float, valid_for: float) -> None:
        """Command a velocity; zero stops a trip as well.

        :raises ModeForbids: the robot is on a trip.
        """
        if v == 0.0 and w == 0.0:
            self._end_trip("stopped by actuator/cmd_vel")
            self.end_velocity()
            return
        self._simulation.need_whole()
        if self.trip is not None:
            raise ModeForbids(
                "the robot is on its way to a goal", remedy="Cancel action/move_to first."
            )
        self._simulation.release()
        self._driving = True
        self.target = (max(-self.limit, min(self.limit, v)), w)
        self._simulation.lapse("cmd_vel", valid_for, self._lapse)

    def end_velocity(self) -> None:
        """End the commanded velocity, but not a trip that has replaced it."""
        self._simulation.forget("cmd_vel")
        self.target = (0.0, 0.0)

    def _lapse(self) -> None:
        self.target = (0.0, 0.0)

    def set_limit(self, limit: float) -> None:
        """Change the maximum speed, also of the motion in progress."""
        self.limit = limit
        v, w = self.target
        self.target = (max(-limit, min(limit, v)), w)

    def yield_wheels(self) -> None:
        """Give up control of the wheels, which are now commanded individually, and stop them."""
        if self._driving:  # otherwise no command would end the speed of the other wheels
            for drive in (*self._left, *self._right):
                self._simulation.neutral(drive)
        self._simulation.forget("cmd_vel")
        self.stop("the wheels are commanded one by one")

    def moves(self, drive: Drive) -> bool:
        """Whether a velocity or a trip sets the speed of a wheel now."""
        return self._driving and drive in (*self._left, *self._right)

    def check_goal(self, trip: Trip) -> None:
        """Refuse a trip into a wall.

        :raises DeviceRejected: its goal is in an obstacle.
        """
        self._obstacles.check(trip.x, trip.y, trip.tolerance)

    def go(self, trip: Trip) -> None:
        """Start a trip.

        :raises DeviceRejected: its goal is in an obstacle.
        """
        self._simulation.need_whole()
        self.check_goal(trip)
        self._end_trip("another goal was given")
        self._simulation.forget("cmd_vel")
        self._simulation.release()
        self._driving = True
        self.trip = trip

    def abandon(self, trip: Trip) -> None:
        """Cancel a trip: brake within the limits."""
        if self.trip is trip:
            self._end_trip("cancelled")

    def _end_trip(self, reason: str) -> None:
        if self.trip is not None:
            self.trip.failure = reason
            self.trip = None
        self.target = (0.0, 0.0)

    def stop(self, reason: str) -> None:
        """End the motion; the caller brakes, or commands the wheels from now on."""
        self._end_trip(reason)
        self._ramp = (0.0, 0.0)
        self._driving = False

    def kept(self) -> Sequence[int]:
        """No actuators."""
        return ()

    def reset(self) -> None:
        """Restart odometry here, with the maximum speed limit."""
        self.limit = self.config.speed
        self.odometry = (0.0, 0.0, 0.0)
        self._turned = self._wheel_angles()

    # Measurements

    @property
    def pose(self) -> tuple[float, float, float]:
        """Position and heading of the base in the world."""
        data = self._simulation.data
        x, y, _ = data.xpos[self._body]
        w, i, j, k = data.xquat[self._body]
        return float(x), float(y), math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    @property
    def body(self) -> tuple[list[float], list[float]]:
        """Position and quaternion (w first) of the base."""
        data = self._simulation.data
        return data.xpos[self._body].tolist(), data.xquat[self._body].tolist()

    @property
    def velocity(self) -> tuple[float, float]:
        """Speed and yaw rate by the wheels, m/s and rad/s."""
        data = self._simulation.data
        left = self._mean(self._left, data.qvel) * self.config.radius
        right = self._mean(self._right, data.qvel) * self.config.radius
        return (left + right) / 2, (right - left) / self.config.track

    def _wheel_angles(self) -> tuple[float, float]:
        data = self._simulation.data
        angles = [
            sum(float(data.qpos[d.joint.qpos]) for d in side if d.joint) / len(side)
            for side in (self._left, self._right)
        ]
        return angles[0], angles[1]

    def _mean(self, side: list[Any], values: Any) -> float:
        return sum(float(values[dof]) for drive in side for dof in drive.dofs) / len(side)

    # Steps

    def control(self, dt: float) -> None:
        """Set the wheels' speeds for the next step."""
        self._count()
        wanted = self.target
        if self.trip is not None:
            wanted = self._follow(self.trip, dt)
        if not self._driving:
            return
        v, w = self._ramp
        most = self.config.acceleration * dt
        v += max(-most, min(most, wanted[0] - v))
        most /= self.config.track / 2
        w += max(-most, min(most, wanted[1] - w))
        self._ramp = (v, w)
        self._set(v, w)

    def _set(self, v: float, w: float) -> None:
        config, controls = self.config, self._simulation.data.ctrl
        for side, sign in ((self._left, -1), (self._right, 1)):
            speed = (v + sign * w * config.track / 2) / config.radius
            for drive in side:
                controls[drive.number] = drive.control(speed)

    def _count(self) -> None:
        old, self._turned = self._turned, self._wheel_angles()
        left, right = (
            (now - before) * self.config.radius
            for now, before in zip(self._turned, old, strict=True)
        )
        x, y, yaw = self.odometry
        way, turn = (left + right) / 2, (right - left) / self.config.track
        middle = yaw + turn / 2
        self.odometry = (x + way * math.cos(middle), y + way * math.sin(middle), yaw + turn)

    # Trips

    def _follow(self, trip: Trip, dt: float) -> tuple[float, float]:
        trip.seconds += dt
        x, y, yaw = self.pose
        trip.left = math.hypot(trip.x - x, trip.y - y)
        if trip.left <= trip.tolerance and trip.phase in ("turning", "driving"):
            trip.enter("aligning" if trip.yaw is not None else "braking")
        match trip.phase:
            case "turning" | "driving":
                off = _wrapped(math.atan2(trip.y - y, trip.x - x) - yaw)
                wanted = self._approach(trip, off)
                stuck = trip.is_stuck(trip.left if trip.phase == "driving" else abs(off))
            case "aligning":
                off = _wrapped((trip.yaw or 0.0) - yaw)
                if abs(off) < _HEADING:
                    trip.enter("braking")
                wanted = (0.0, self._turn(off))
                stuck = trip.is_stuck(abs(off))
            case _:
                wanted, stuck = (0.0, 0.0), False
                if self._simulation.at_rest:
                    self._arrive(trip)
        if stuck:
            self._end_trip(f"no progress for {_PATIENCE:g} s: something is in the way")
            return (0.0, 0.0)
        return wanted

    def _arrive(self, trip: Trip) -> None:
        """End a trip at rest, by its current pose."""
        if trip.left > trip.tolerance:
            trip.enter("turning")
            return
        trip.phase = "done"
        self.trip = None

    def _approach(self, trip: Trip, off: float) -> tuple[float, float]:
        if trip.phase == "turning":
            if abs(off) > _AIMED:
                return (0.0, self._turn(off))
            trip.enter("driving")
        elif abs(off) > 4 * _AIMED:
            trip.enter("turning")
        most = min(self.limit, trip.speed or math.inf)
        braking = math.sqrt(2 * _BRAKING * self.config.acceleration * trip.left)
        v = min(most, max(_CREEP, braking)) * max(0.0, 1 - _LEAN * abs(off) / _AIMED)
        return (v if most else 0.0, self._turn(off))

    def _turn(self, off: float) -> float:
        most = self.config.turn
        return max(-most, min(most, _TURNING * off))

    def pace(self, trip: Trip) -> float:
        """The speed available on a trip, m/s."""
        return min(self.limit, trip.speed or math.inf)


def make_trip(
    x: float, y: float, yaw: float | None, tolerance: float | None, speed: float | None
) -> Trip:
    """Make a trip with the robot's default tolerance."""
    return Trip(x, y, yaw, tolerance=tolerance or _TOLERANCE, speed=speed)


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau)
