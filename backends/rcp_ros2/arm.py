"""`action/move_joints` and `action/follow_trajectory` with a controller of ros2_control."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Collection, Iterable
from collections.abc import Mapping as Named
from typing import Any, NamedTuple

import msgspec

from rcp_kernel.clock import parse_time
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    OutOfRange,
)
from rcp_kernel.spi import Progress
from rcp_profiles import Keyed, bounded
from rcp_profiles import messages as m
from rcp_ros2.actions import Run
from rcp_ros2.binding import Shared
from rcp_ros2.config import Mapping
from rcp_ros2.description import JointLimits
from rcp_ros2.shapes import seconds
from rcp_ros2.stamps import Delays
from rcp_ros2.standard import defined

__all__ = ["ArmJoints", "FollowTrajectory", "JointMotion", "MoveJoints"]

_SPEED = 0.3  # rad/s or m/s, the highest of a joint whose description tells none
_ACCELERATION = 1.5  # rad/s² or m/s²: descriptions have none
_SHORTEST = 0.1  # s that a motion takes
_PEAK = 1.5  # highest over mean speed of a cubic curve from rest to rest
_NEAR = 0.03  # rad or m from its goal at which a joint has arrived
_STILL = 0.03  # rad/s or m/s
_ARRIVAL = 4.0  # s for the joints to arrive, or to come to rest, after the controller's last word
_APART = 0.05  # s between two positions of which a speed is made
_ROUNDING = 1.001
"""Ratio by which a mean speed may exceed the limit."""


class ArmJoints(NamedTuple):
    """The joints of one controller."""

    names: tuple[str, ...] = ()
    """In its order; empty if it does not tell: then all of the joint states."""
    limits: tuple[tuple[str, JointLimits], ...] = ()


class _Point(NamedTuple):
    time: float
    positions: dict[str, float]
    velocities: dict[str, float] | None


class _Measured(NamedTuple):
    positions: dict[str, float]
    velocities: dict[str, float]
    at: float
    """Monotonic time of the oldest part."""


class JointMotion(Run):
    """A motion of one controller's joints."""

    def __init__(
        self,
        shared: Shared,
        name: str,
        standard: str,
        mapping: Mapping,
        action: Any,
        *,
        joints: ArmJoints,
        states: Callable[[], Awaitable[m.JointStates]],
    ) -> None:
        """Measure with `states`."""
        super().__init__(shared, name, mapping, action)
        self.joints = joints
        self._limits = dict(joints.limits)
        self._states = states
        self._delays = Delays()
        own = self.resource
        self.resource = defined(
            name,
            standard,
            mapping,
            **self._types(),
            native=own.native,
            meta=own.meta | {"joints": list(joints.names)},
        )
        self.standard = standard

    def _types(self) -> dict[str, Any]:
        raise NotImplementedError

    @property
    def is_busy(self) -> bool:
        """Whether a goal is running."""
        return bool(self._goals)

    def _bounds(self, prefix: str) -> dict[str, tuple[float | None, float | None]]:
        limits = {name: self._limits.get(name, JointLimits()) for name in self.joints.names}
        return {f"{prefix}.{name}": (one.low, one.high) for name, one in limits.items()}

    def _middle(self) -> dict[str, float]:
        """Return an example of positions."""
        found: dict[str, float] = {}
        for name in self.joints.names:
            low, high = self._limits.get(name, JointLimits())[:2]
            found[name] = 0.0 if low is None or high is None else round((low + high) / 2, 3)
        return found

    # -- measurements ----------------------------------------------------------------------------

    async def _measure(self, names: Collection[str]) -> _Measured:
        """Return where joints are: a robot with several drivers tells some of them in each message.

        :raises AdapterUnavailable: the joint states lack one.
        """
        found, end = _Measured({}, {}, math.inf), time.monotonic() + self.timeout
        while not found.positions.keys() >= set(names):
            if time.monotonic() >= end:
                raise self._lacking(set(names) - found.positions.keys())
            state = await self._states()
            if not set(names).isdisjoint(state.name):
                found = found._replace(at=min(found.at, await self._measured(state)))
            found.positions.update(zip(state.name, state.position, strict=False))
            found.velocities.update(zip(state.name, state.velocity, strict=False))
        return found

    async def _here(self, given: Collection[str]) -> dict[str, float]:
        """Return where the controller's joints are.

        If it does not tell which those are: the joints of a message that has the `given` ones.

        :raises AdapterUnavailable: the joint states lack one, or all.
        """
        if self.joints.names:
            return (await self._measure(self.joints.names)).positions
        found: dict[str, float] = {}
        end = time.monotonic() + self.timeout
        while True:
            state = await self._states()
            one = dict(zip(state.name, state.position, strict=False))
            if one and one.keys() >= set(given):
                return one
            found.update(one)
            if time.monotonic() >= end:
                break
        if not found:
            raise self._lacking(("positions",))
        return found

    def _lacking(self, missing: Iterable[str]) -> AdapterUnavailable:
        return AdapterUnavailable(
            f"the joint states lack {', '.join(sorted(missing))}, of {self.mapping.target}",
            remedy="Check the controller's joints and its joint_state_broadcaster.",
        )

    async def _measured(self, state: m.JointStates) -> float:
        """Return the monotonic time when joint states that have just arrived were measured."""
        now = time.monotonic()
        if state.timestamp is None:
            return now
        stamp = parse_time(state.timestamp)
        if self.shared.config.use_sim_time:
            return await self.shared.ros.call(self.shared.ticks.measured, stamp, now)
        return self._delays.measured(stamp, now)

    async def _still(
        self, names: Collection[str], is_there: Callable[[Named[str, float]], bool]
    ) -> _Measured:
        """Wait until joints are measured at rest for a while, where they should be.

        What was measured before does not count: it may come late, from before the motion.

        :raises TimeoutError: they are not.
        """
        began = time.monotonic()
        last: _Measured | None = None
        while time.monotonic() < began + _ARRIVAL:
            found = await self._measure(names)
            if found.at <= began:
                continue
            if last is None:
                last = found
            elif found.at - last.at >= _APART:
                if _rests(names, last, found) and is_there(found.positions):
                    return found
                last = found
        raise TimeoutError

    def _off(self, name: str, position: float, goal: float) -> float:
        off = position - goal
        turns = self._limits.get(name, JointLimits()).continuous
        return abs(math.remainder(off, math.tau) if turns else off)

    # -- motion ----------------------------------------------------------------------------------

    async def _move(
        self, points: list[_Point], report: Callable[[Any, float], None]
    ) -> m.JointsMoved:
        """Run a trajectory to its measured end."""
        names = tuple(points[-1].positions)
        began = time.monotonic()

        def told(feedback: Any = None, *, fraction: float | None = None) -> None:  # noqa: ARG001 - as `Progress`
            report(feedback, time.monotonic() - began)

        try:
            result = await self.follow(self._message(names, points), told)
            if result.error_code:
                raise DeviceRejected(f"{self.mapping.target} failed: {result.error_string}")
            positions = await self._arrived(points[-1].positions)
        except asyncio.CancelledError:
            resting = asyncio.ensure_future(self._rest(names))
            resting.add_done_callback(lambda task: task.cancelled() or task.exception())
            await asyncio.shield(resting)
            raise
        return m.JointsMoved(positions, time.monotonic() - began)

    def _message(self, names: tuple[str, ...], points: list[_Point]) -> Any:
        plain = [
            {
                "positions": [point.positions[name] for name in names],
                "velocities": [(point.velocities or {}).get(name, 0.0) for name in names]
                if point.velocities is not None
                else [],
                "time_from_start": _duration(point.time),
            }
            for point in points
        ]
        trajectory = {"joint_names": list(names), "points": plain}
        return self._fill(msgspec.convert({"trajectory": trajectory}, self._input))

    async def _arrived(self, goal: dict[str, float]) -> dict[str, float]:
        """Wait for the joints to be where the controller says that they are.

        A controller without tolerances reports success when the time is over.
        """
        positions: Named[str, float] = {}

        def is_there(found: Named[str, float]) -> bool:
            nonlocal positions
            positions = found
            return all(self._off(name, found[name], goal[name]) <= _NEAR for name in goal)

        try:
            found = (await self._still(goal, is_there)).positions
            return {name: found[name] for name in goal}
        except TimeoutError:
            off = {
                name: self._off(name, positions.get(name, math.inf), goal[name]) for name in goal
            }
            worst = max(off, key=off.__getitem__)
            raise DeviceRejected(
                f"{worst} is {off[worst]:.3f} rad (or m) from its goal, although "
                f"{self.mapping.target} reported success",
                remedy="Check what blocks the joint, and the `constraints` of the controller.",
            ) from None

    async def _rest(self, names: Collection[str]) -> None:
        """Wait for cancelled joints to come to rest.

        :raises DeviceTimeout: they still move.
        """
        try:
            await self._still(names, lambda _: True)
        except TimeoutError:
            raise DeviceTimeout(
                f"{self.mapping.target} cancelled the goal, but its joints still move",
                remedy="Use the e-stop.",
            ) from None

    def _check(self, positions: Named[str, float], names: Collection[str], pointer: str) -> None:
        unknown = sorted(positions.keys() - set(names))
        if unknown or not positions:
            raise InvalidValue(
                f"the arm has no joint {', '.join(unknown)}" if unknown else "no joint to move",
                details={"pointer": pointer},
                remedy=f"Its joints are {', '.join(sorted(names))}.",
            )
        if not all(map(math.isfinite, positions.values())):
            raise InvalidValue("a position is not a number", details={"pointer": pointer})

    def _fastest(self, name: str) -> float:
        return self._limits.get(name, JointLimits()).speed or _SPEED


class MoveJoints(JointMotion):
    """Joints that move together, from rest to rest."""

    def _types(self) -> dict[str, Any]:
        names, bounds = self.joints.names, self._bounds("positions")
        examples = ({"positions": self._middle(), "speed": 0.5},) if names else ()
        return {"input": bounded(m.MoveJoints, bounds), "examples": examples}

    async def execute(self, value: Any, progress: Progress) -> m.JointsMoved:
        """Move joints; raises as for any action.

        :raises InvalidValue: there is no such joint.
        """
        given = _given(value.positions)
        here = await self._here(given)
        names = self.joints.names or tuple(here)
        self._check(given, names, "/positions")
        goal = {name: given.get(name, here[name]) for name in names}
        duration = self._duration(here, goal) / value.speed
        still = dict.fromkeys(names, 0.0)

        def report(feedback: Any, _: float) -> None:
            actual = _actual(feedback)
            if actual.keys() >= given.keys():
                left = max(self._off(name, actual[name], goal[name]) for name in given)
                progress(m.MoveJointsFeedback(actual, left))
            else:
                progress()

        return await self._move([_Point(duration, goal, still)], report)

    def _duration(self, here: Named[str, float], goal: Named[str, float]) -> float:
        """Return how long a cubic curve takes at the highest speed, s."""
        found = _SHORTEST
        for name, end in goal.items():
            far = abs(end - here[name])
            quick = _PEAK * far / self._fastest(name)
            found = max(found, quick, math.sqrt(4 * _PEAK * far / _ACCELERATION))
        return found


class FollowTrajectory(JointMotion):
    """Joints that move through waypoints."""

    def _types(self) -> dict[str, Any]:
        names = self.joints.names
        bounds = self._bounds("points.positions")
        for name in names:
            speed = self._limits.get(name, JointLimits()).speed
            bounds[f"points.velocities.{name}"] = (None if speed is None else -speed, speed)
        examples = ({"points": [{"time": 10.0, "positions": self._middle()}]},) if names else ()
        return {"input": bounded(m.FollowTrajectory, bounds), "examples": examples}

    async def execute(self, value: Any, progress: Progress) -> m.JointsMoved:
        """Follow a trajectory; raises as for any action.

        :raises InvalidValue: it names a joint that there is not, or its times do not increase.
        :raises OutOfRange: a joint would have to move faster than it can.
        """
        here = await self._here({name for one in value.points for name in _given(one.positions)})
        names = self.joints.names or tuple(here)
        points = self._planned(value.points, names, {name: here[name] for name in names})

        def report(feedback: Any, elapsed: float) -> None:
            actual = _actual(feedback)
            if not actual:
                progress()
                return
            told = seconds(feedback.desired.time_from_start)
            off = (abs(one) for one in feedback.error.positions if math.isfinite(one))
            progress(m.TrajectoryFeedback(told or elapsed, actual, max(off, default=0.0)))

        return await self._move(points, report)

    def _planned(
        self, waypoints: list[Any], names: tuple[str, ...], here: dict[str, float]
    ) -> list[_Point]:
        """Return the points with a position of every joint; one that is not named stays."""
        found: list[_Point] = []
        before = 0.0
        for number, waypoint in enumerate(waypoints):
            place, given = f"/points/{number}", _given(waypoint.positions)
            self._check(given, names, f"{place}/positions")
            if waypoint.time <= before and (found or waypoint.time < 0):
                raise InvalidValue(
                    "the times of the points do not increase",
                    details={"pointer": f"{place}/time"},
                )
            velocities = None
            if waypoint.velocities is not None:
                velocities = _given(waypoint.velocities)
                self._check(velocities, names, f"{place}/velocities")
            there = here | given
            self._check_speed(here, there, waypoint.time - before, place)
            found.append(_Point(waypoint.time, there, velocities))
            here, before = there, waypoint.time
        return found

    def _check_speed(
        self, here: dict[str, float], there: dict[str, float], duration: float, place: str
    ) -> None:
        for name, end in there.items():
            limit, far = self._limits.get(name, JointLimits()).speed, abs(end - here[name])
            if limit is None or far <= _NEAR or far <= limit * duration * _ROUNDING:
                continue
            raise OutOfRange(
                f"{name} would move {far:.2f} rad (or m) in {duration:g} s, but its limit is "
                f"{limit:g} rad/s (or m/s)",
                remedy="Leave more time between the points.",
                details={"pointer": f"{place}/time"},
            )


def _rests(names: Collection[str], first: _Measured, last: _Measured) -> bool:
    """Return whether joints rest at both of two moments, or between them without velocities."""
    if all(one.velocities.keys() >= set(names) for one in (first, last)):
        speeds = [abs(one.velocities[name]) for one in (first, last) for name in names]
    else:
        apart = last.at - first.at
        speeds = [abs(last.positions[name] - first.positions[name]) / apart for name in names]
    return all(speed <= _STILL for speed in speeds)  # false for NaN


def _given(values: Any) -> dict[str, float]:
    return values.given() if isinstance(values, Keyed) else dict(values)


def _duration(duration: float) -> dict[str, int]:
    whole, rest = divmod(round(duration * 1e9), 1_000_000_000)
    return {"sec": whole, "nanosec": rest}


def _actual(feedback: Any) -> dict[str, float]:
    """Return the positions in a feedback; none if they are not known."""
    if feedback is None:
        return {}
    positions = dict(zip(feedback.joint_names, feedback.actual.positions, strict=False))
    return positions if all(map(math.isfinite, positions.values())) else {}
