"""Joint groups: several motors commanded together, with synchronized moves and trajectories."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Any

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.config_joints import JointGroupConfig
from rcp_can.cubic import Cubic
from rcp_can.joint_limits import joint_limits
from rcp_can.joint_resources import JointNames, joint_resources
from rcp_can.joint_run import JointRun
from rcp_can.joint_types import joint_types
from rcp_can.joint_watch import MoveWatch, TrajectoryWatch
from rcp_can.motor import released
from rcp_can.path import Leg, Path
from rcp_can.preconditions import check, check_feedback, check_link, ready
from rcp_can.trajectory import Trajectory
from rcp_can.trajectory_plan import Joint, Point, plan
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import AdapterUnavailable, ConfigError, InvalidValue, ModeForbids, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress, check_fence
from rcp_profiles.messages import JointsMoved, JointStates

__all__ = ["JointGroupPart"]

_FEW = 200  # points of a trajectory that are planned on the event loop
_LATE = 1.5  # periods that a set-point may go on at once, however late it is


class JointGroupPart(Part):
    """One joint group; its joints also remain separate motors.

    :raises ConfigError: one of the motors has no position control, or no position in its limits.
    """

    def __init__(
        self, name: str, config: JointGroupConfig, axes: Sequence[Axis], host: Host
    ) -> None:
        for axis in axes:
            if "position" not in axis.drive.modes:
                raise ConfigError(
                    f"joint_groups.{name}.joints: '{axis.name}' ({axis.config.profile}) has no "
                    "position control; remove it"
                )
        self._name, self._config, self._host = name, config, host
        self._joints = {axis.name: axis for axis in axes}
        self._limits = {axis.name: joint_limits(name, config, axis) for axis in axes}
        self._place = None if config.as_robot else name
        self._names = JointNames.make(self._place)
        self._types = joint_types(self._limits)
        self._late = _LATE / min(axis.config.rate for axis in axes)
        self._run: JointRun | None = None
        """The move in progress."""
        self._seen = 0
        for bus in {axis.bus for axis in axes}:
            bus.after_batch(self._batch)

    def resources(self) -> list[Resource]:
        """Claim the profile `arm`."""
        timeout = max(axis.config.timeout for axis in self.axes)
        return joint_resources(self._config, self._limits, self._types, timeout, self._place)

    # What it measures

    def _batch(self) -> None:
        seen = sum(axis.status.moved for axis in self.axes)
        fresh = all(axis.online and axis.blind is None for axis in self.axes)
        if seen == self._seen or not fresh:
            return
        self._seen = seen
        for name in (self._names.joints, self._names.states):
            if (value := self._value(name)) is not None:
                self._host.publish(name, value)

    def _value(self, name: str) -> Any:
        positions = _known(axis.position for axis in self.axes)
        velocities = _known(axis.velocity for axis in self.axes)
        if positions is None or velocities is None:
            return None
        if name == self._names.joints:
            types = self._types
            return types.states(
                positions=_filled(types.positions, positions),
                velocities=_filled(types.velocities, velocities),
            )
        efforts = _known(_torque(axis) for axis in self.axes)
        return JointStates([*self._joints], positions, velocities, efforts, iso(now()))

    def _positions(self) -> dict[str, float]:
        """Return the positions that are known: all of them, while a move runs."""
        found = {name: axis.position for name, axis in self._joints.items()}
        return {name: position for name, position in found.items() if position is not None}

    async def read(self, name: str) -> Any:
        """Return the last positions, if all drives are still connected."""
        if name not in (self._names.joints, self._names.states):
            return await super().read(name)
        for axis in self.axes:
            check_link(axis)
            check_feedback(axis)
        if (value := self._value(name)) is None:
            raise AdapterUnavailable(
                f"not every joint of '{self._name}' has reported its position yet"
            )
        return value

    # Set-points

    async def write(self, name: str, value: Any) -> None:
        """Set the positions of all listed joints or of none; the others keep theirs."""
        check_fence()
        fields = zip(self.axes, value.__struct_fields__, strict=True)
        wanted = {axis: getattr(value, field) for axis, field in fields}
        targets = {axis: position for axis, position in wanted.items() if position is not None}
        if not targets:
            self.settle(ModeForbids(f"a stop of '{self._name}' ended the move"))
            return
        for axis in targets:
            self._check(axis)
        for axis in self.axes:
            if axis in targets:
                axis.command("position", targets[axis])
                axis.ramp.limit = self._limits[axis.name].velocity
            else:
                _rest(axis, ModeForbids(f"a stop of '{self._name}' ended the move"))

    def _check(self, axis: Axis) -> None:
        if axis.owner is not None:
            raise ModeForbids(
                f"motor '{axis.name}' is driven by {axis.owner}",
                remedy="Cancel that command first.",
            )
        check(axis)

    # What the services of its motors do with it

    @property
    def axes(self) -> Sequence[Axis]:
        """Its motors."""
        return tuple(self._joints.values())

    def settle(self, reason: RcpError) -> None:
        """Bring all joints to rest; what drives them ends with `reason`."""
        if self._run is not None:
            self._run.end(reason)
            return
        for axis in self.axes:
            _rest(axis, reason)
        for axis in self.axes:  # a stop that may not have reached every joint is no stop
            check_link(axis)

    def reset(self) -> None:
        """Do nothing: it counts nothing, and has no parameters."""

    # Moves

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Move the joints together, in a straight line or along a trajectory."""
        for axis in self.axes:
            await ready(axis)
            await released(axis)
        started = time.monotonic()
        if name == self._names.move:
            await self._move(value, progress)
        else:
            await self._follow(value, progress)
        return JointsMoved(self._positions(), time.monotonic() - started)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a move of motors that accept no commands, or a trajectory that they cannot follow.

        A long trajectory is planned only when it is executed.
        """
        for axis in self.axes:
            check_link(axis)
        if name == self._names.move:
            self._goals(value)
            return
        axes = self._followers(value)
        if len(value.points) <= _FEW:
            joints = {axis.name: Joint(self._start(axis), self._limits[axis.name]) for axis in axes}
            plan(_points(value.points), joints, self._config.tracking_tolerance)

    def _goals(self, move: Any) -> dict[Axis, float]:
        """Return where each joint is to go.

        :raises RcpError: there is none, or one accepts no commands.
        """
        targets: dict[str, float] = move.positions.given()
        if not targets:
            raise InvalidValue("no joint to move", details={"pointer": "/positions"})
        goals = {self._joints[name]: position for name, position in targets.items()}
        for axis in goals:
            self._check(axis)
        return goals

    async def _move(self, move: Any, progress: Progress) -> None:
        goals = self._goals(move)
        legs = {axis: self._leg(axis, goal, move.speed) for axis, goal in goals.items()}
        path = Path(legs.values(), late=self._late)
        follows = {axis: path.follow(leg) for axis, leg in legs.items()}
        watch = MoveWatch(goals, lambda: path.part, self._positions, progress)
        await self._go(JointRun(self._names.move, path, goals, follows), watch)

    def _leg(self, axis: Axis, goal: float, speed: float) -> Leg:
        limits = self._limits[axis.name]
        return Leg(self._start(axis), goal, limits.velocity * speed, limits.acceleration)

    async def _follow(self, wanted: Any, progress: Progress) -> None:
        axes = self._followers(wanted)
        tolerance = self._config.tracking_tolerance
        curves = await self._plan(wanted.points, axes)
        last = wanted.points[-1]
        accelerations = [self._limits[name].acceleration for name in curves]
        line = Trajectory([*curves.values()], accelerations, last.time, self._late)
        positions = last.positions.given()
        goals = {self._joints[name]: positions[name] for name in curves}
        follows = {axis: line.follow(number) for number, axis in enumerate(goals)}
        watch = TrajectoryWatch(axes, line, tolerance, self._positions, progress)
        await self._go(JointRun(self._names.follow, line, goals, follows), watch)

    def _followers(self, wanted: Any) -> list[Axis]:
        """Return the joints of a trajectory.

        :raises RcpError: one accepts no commands, or moves.
        """
        axes = [self._joints[name] for name in wanted.points[0].positions.given()]
        for axis in axes:
            self._check(axis)
            if not axis.resting:
                raise ModeForbids(
                    f"joint '{axis.name}' is moving", remedy="Bring it to rest first."
                )
        return axes

    async def _plan(self, waypoints: Sequence[Any], axes: Sequence[Axis]) -> dict[str, Cubic]:
        """Plan the curves in a thread, because thousands of points would hold up the event loop.

        :raises RcpError: the joints cannot follow, or were stopped in the meantime.
        """
        joints = {axis.name: Joint(self._start(axis), self._limits[axis.name]) for axis in axes}
        ended: list[RcpError] = []
        for axis in axes:
            axis.owner, axis.ended = self._names.follow, ended.append
        try:
            curves = await asyncio.to_thread(
                lambda: plan(_points(waypoints), joints, self._config.tracking_tolerance)
            )
        finally:
            for axis in axes:
                axis.owner = axis.ended = None
        if ended:
            raise ended[0]
        for axis in axes:
            check(axis)
        return curves

    def _start(self, axis: Axis) -> float:
        """Return where a move begins: where the joint was told to stay, if it is near that."""
        here, kept = axis.position, axis.ramp.position
        assert here is not None  # checked before
        near = abs(kept - here) <= self._config.tracking_tolerance
        return kept if axis.mode == "position" and axis.resting and near else here

    async def _go(self, run: JointRun, watch: Callable[[], None]) -> None:
        self._run = run
        try:
            await run.run(watch)
        finally:
            if self._run is run:
                self._run = None


def _points(waypoints: Sequence[Any]) -> list[Point]:
    return [
        Point(each.time, each.positions.given(), each.velocities.given() if each.velocities else {})
        for each in waypoints
    ]


def _rest(axis: Axis, reason: RcpError) -> None:
    driven = axis.owner is not None
    if driven:
        axis.forget(reason)
    if axis.status.enabled and not axis.stopped:
        if driven:  # perhaps by the drive's own trajectory, which no set-point stops
            axis.rest()
        else:
            axis.hold()


def _known(values: Any) -> list[float] | None:
    found: list[float | None] = list(values)
    return None if None in found else [each for each in found if each is not None]


def _torque(axis: Axis) -> float | None:
    raw = axis.status.torque
    return None if raw is None else raw * axis.ratio


def _filled(kind: Any, values: Sequence[float]) -> Any:
    return kind(**dict(zip(kind.__struct_fields__, values, strict=True)))
