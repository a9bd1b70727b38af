"""Two motors as one robot: a differential drive with `cmd_vel`, odometry and `move_to`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rcp_can.axis import Axis
from rcp_can.axle import Axle
from rcp_can.base_messages import DriveStopped
from rcp_can.base_move import BaseMove
from rcp_can.base_resources import BaseNames, base_resources
from rcp_can.binding import Part
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_can.motor import released
from rcp_can.odometry import Odometry
from rcp_can.preconditions import check_feedback, check_link, ready
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import AdapterUnavailable, ConfigError, InvalidValue, ModeForbids, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress, check_fence
from rcp_kernel.types import AngularVelocity, LinearVelocity, Point, PoseStamped, Quaternion, Twist
from rcp_profiles.messages import MoveResult, MoveTo, TwistStamped

__all__ = ["DiffDrivePart"]

_FRAMES = "odom", "map"
"""Frames of goals: without a map, both start at the origin of the odometry (REP-105)."""


class DiffDrivePart(Part):
    """One differential drive; its wheels also remain separate motors."""

    def __init__(
        self, name: str, config: DiffDriveConfig, left: Axis, right: Axis, host: Host
    ) -> None:
        """Create the drive.

        :raises ConfigError: a motor reports no position, of which the odometry is made.
        """
        for wheel in (left, right):
            if not wheel.drive.places:
                raise ConfigError(
                    f"diff_drives.{name}: motor '{wheel.name}' ({wheel.config.profile}) reports no "
                    "position, which odometry needs"
                )
        self._config, self._host = config, host
        self._place = None if config.as_robot else name
        self._names = BaseNames.make(self._place)
        self._axle = Axle(config, left, right)
        self._odometry = Odometry(config, left, right)
        self._velocity: Twist | None = None
        """The commanded velocity in force, before the speed limit."""
        for bus in {left.bus, right.bus}:
            bus.after_batch(self._batch)

    def resources(self) -> list[Resource]:
        """Claim the profile `mobile`."""
        return base_resources(self._config, self._axle, self._place)

    # Measurements

    def _batch(self) -> None:
        fresh = all(wheel.online and wheel.blind is None for wheel in self._axle.wheels)
        if fresh and self._odometry.update():
            at = iso(now())
            self._host.publish(self._names.pose, self._pose(at))
            if (velocity := self._moving(at)) is not None:
                self._host.publish(self._names.velocity, velocity)

    def _pose(self, at: str) -> PoseStamped:
        x, y, heading = self._odometry.place
        turned = Quaternion(z=math.sin(heading / 2), w=math.cos(heading / 2))
        return PoseStamped(Point(x, y), turned, "odom", at)

    def _moving(self, at: str) -> TwistStamped | None:
        moving = self._axle.moving
        if moving is None:
            return None
        forward, turn = moving
        return TwistStamped(LinearVelocity(forward), AngularVelocity(z=turn), timestamp=at)

    async def read(self, name: str) -> Any:
        """Return the last measurements, if both wheels are still connected."""
        if name == self._names.speed_limit:
            return self._axle.speed_limit
        if name not in (self._names.pose, self._names.velocity):
            return await super().read(name)
        for wheel in self._axle.wheels:
            check_link(wheel)
            check_feedback(wheel)
        value = self._pose(iso(now())) if name == self._names.pose else self._moving(iso(now()))
        if value is None:
            raise AdapterUnavailable("a wheel has not reported its velocity yet")
        return value

    # Commands

    async def write(self, name: str, value: Any) -> Any:
        """Set the velocity or the speed limit; return the value in force."""
        if name == self._names.speed_limit:
            self._limit(value)
            return None
        check_fence()
        forward, turn = value.linear.x, value.angular.z
        if not forward and not turn:
            self.settle(ModeForbids("a velocity of zero ended the move"))
            return None
        self._axle.check_range(forward, turn)
        self._axle.check(self._names.cmd_vel)
        self._velocity = value
        return self._drive(value)

    def _drive(self, wanted: Twist) -> Twist | None:
        """Turn the wheels within the speed limit; return the value in force if it differs."""
        forward, turn = self._axle.limited(wanted.linear.x, wanted.angular.z)
        self._axle.drive(forward, turn, self._names.cmd_vel, self._lost)
        if forward == wanted.linear.x:
            return None
        return Twist(LinearVelocity(forward), AngularVelocity(z=turn))

    def _lost(self, wheel: Axis, reason: RcpError) -> None:
        """Report why the robot was stopped."""
        self._velocity = None
        self._host.publish(
            self._names.stopped,
            DriveStopped(motor=wheel.name, reason=reason.code, text=reason.message),
        )

    def _limit(self, value: float) -> None:
        self._axle.speed_limit = value
        self._host.publish(self._names.speed_limit, value)
        if self._velocity is not None and self._axle.owner == self._names.cmd_vel:
            self._drive(self._velocity)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Drive to a place."""
        goal: MoveTo = value
        self._check_frame(goal)
        for wheel in self._axle.wheels:
            await ready(wheel)
            await released(wheel)
        period = 1 / self._axle.wheels[0].config.rate
        move = BaseMove(self._names.move_to, self._axle, self._odometry, self._config.track, period)
        error = await move.run(goal, progress)
        return MoveResult(self._pose(iso(now())), error)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a goal in an unknown frame, and one that the wheels would not accept now."""
        self._check_frame(value)
        self._axle.check(self._names.move_to)

    def _check_frame(self, goal: MoveTo) -> None:
        if goal.frame not in _FRAMES:
            raise InvalidValue(
                f"there is no transform from '{goal.frame}' to 'odom'",
                remedy="Give the goal in the frame 'odom'.",
                details={"pointer": "/frame"},
            )

    # Called by the services of its motors

    @property
    def axes(self) -> Sequence[Axis]:
        """Its motors."""
        return self._axle.wheels

    def settle(self, reason: RcpError) -> None:
        """Bring both wheels to rest; the running command ends with `reason`."""
        self._velocity = None
        for wheel in self._axle.wheels:
            if wheel.owner not in (None, self._names.cmd_vel):
                wheel.forget(reason)
        self._axle.rest()

    def reset(self) -> None:
        """Reset odometry and speed limit."""
        self._limit(self._axle.top_speed)
        self._odometry.reset()
