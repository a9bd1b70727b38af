"""The measured velocity of a robot: whether it is at rest, and the age of the measurement.

Samples are received in the ROS thread; the state can be queried from any thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rcp_kernel.spi import MotionState
from rcp_ros2.cdr import Codec, Malformed, Value
from rcp_ros2.config import Qos
from rcp_ros2.idl import MissingType, load
from rcp_ros2.link import RosLink
from rcp_ros2.stamps import Delays, Ticks
from rcp_ros2.topics import Tap

__all__ = ["ODOMETRY", "Feedback", "Feedbacks"]

ODOMETRY = "nav_msgs/msg/Odometry"
_APART = 0.1  # s between two positions of which a speed is made
_SETTLE = 0.1  # s of measured rest required: a velocity may merely cross zero
Measured = tuple[float, float]
"""Speed in m/s and rate of turn in rad/s."""


class _Measurement(NamedTuple):
    speeds: Measured
    at: float
    """Monotonic time."""


def _twist(value: Any, at: float) -> _Measurement:
    linear, angular = value.linear, value.angular
    speed = math.hypot(linear.x, linear.y, linear.z)
    return _Measurement((speed, math.hypot(angular.x, angular.y, angular.z)), at)


class Joints:
    """The speed of the fastest joint, from messages that each may have a part of the joints."""

    def __init__(self, max_age: float) -> None:
        self.needed: frozenset[str] = frozenset()
        """The joints that are measured; empty: those of each message."""
        self._max_age = max_age
        self._speeds: dict[str, tuple[float, float]] = {}
        """By name: when it was measured, and the speed."""
        self._places: dict[str, tuple[float, float]] = {}
        """By name: a time and the position then, of joints without a velocity."""

    def measure(self, state: Any, at: float) -> _Measurement | None:
        """Return the speed, and when the last of the joints was measured; None if unknown."""
        told = bool(len(state.velocity))
        names = list(state.name) or [str(at) for at in range(len(state.velocity))]
        for name, number in zip(names, state.velocity if told else state.position, strict=False):
            if told:
                self._speeds[name] = at, abs(number)
            else:
                self._derive(name, number, at)
        known = (self._speeds.get(name) for name in self.needed or names)
        found = [one for one in known if one is not None and at - one[0] <= self._max_age]
        if not found or len(found) < len(self.needed or names):
            return None
        speeds = [speed for _, speed in found]
        fastest = math.nan if any(map(math.isnan, speeds)) else max(speeds)  # `max` ignores a NaN
        return _Measurement((0.0, fastest), min(moment for moment, _ in found))

    def _derive(self, name: str, position: float, at: float) -> None:
        since, before = self._places.setdefault(name, (at, position))
        if at - since >= _APART:
            self._speeds[name] = at, abs(position - before) / (at - since)
            self._places[name] = at, position


_Measure = Callable[[Any, float], _Measurement | None]
_MEASURES: dict[str, tuple[str | None, _Measure]] = {
    ODOMETRY: ("twist.twist", _twist),
    "geometry_msgs/msg/Twist": (None, _twist),
    "geometry_msgs/msg/TwistStamped": ("twist", _twist),
    "geometry_msgs/msg/TwistWithCovariance": ("twist", _twist),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("twist.twist", _twist),
}
"""The field of each type that contains the velocity, and the function that reads it."""
_JOINT_STATE = "sensor_msgs/msg/JointState"


class Feedback:
    """The velocity from one topic."""

    def __init__(
        self,
        topic: str,
        robot: str | None,
        limits: Measured,
        max_age: float,
        restored: Callable[[], None],
        times: Delays | Ticks,
    ) -> None:
        self.topic = topic
        self.robot = robot
        self.demanded = False
        """Whether the configuration requires it to confirm a stop, and it alone does."""
        self.required = False
        """Whether a stop is not confirmed without it: it alone measures some joints."""
        self.joints = Joints(max_age)
        """Measured if the topic has joint states."""
        self.max_age = max_age
        self._limits = limits
        self._restored = restored
        self._times = times
        """Those of stamped samples."""
        self._measure: _Measure = _twist
        self._at: float | None = None
        """Monotonic time when the newest sample arrived."""
        self._measured_at = -math.inf
        """Monotonic time when it was measured."""
        self._stamp: int | None = None
        self._speed: Measured = (0.0, 0.0)
        self._rest: float | None = None
        """Monotonic time since which rest has been measured."""
        self.type: str | None = None

    def tap(self, type_: str) -> tuple[Any, Tap]:
        """Return the message class and the tap for its subscription.

        :raises MissingType: the type is not installed.
        :raises ValueError: the type contains no velocity.
        """
        measures = _MEASURES | {_JOINT_STATE: (None, self.joints.measure)}
        if type_ not in measures:
            known = ", ".join(sorted(measures))
            raise ValueError(f"{type_} contains no velocity; supported types for feedback: {known}")
        field, self._measure = measures[type_]
        cls = load(type_)
        codec = Codec(cls, field)
        self.type = type_

        def take(value: Value) -> None:
            self._take(value, codec)

        return cls, Tap(f"feedback {self.topic} {self.robot}", codec, taker=take)

    def _take(self, value: Value, codec: Codec) -> None:
        stamp = codec.stamp(value.data)
        if stamp is not None and stamp == self._stamp:
            return  # a driver that repeats its last measurement provides no new one
        now = time.monotonic()
        at = now if stamp is None else self._times.measured(stamp, now)
        try:
            found = self._measure(value.decode(), at)
        except Malformed:
            return
        if found is None:
            return
        lost = self._at is not None and now - self._at > self.max_age
        gap = found.at - self._measured_at > self.max_age
        still = all(
            one <= limit for one, limit in zip(found.speeds, self._limits, strict=True)
        )  # false for NaN
        self._stamp, self._speed = stamp, found.speeds
        if not still:
            self._rest = None
        elif self._rest is None or lost or gap:
            self._rest = found.at
        self._at, self._measured_at = now, found.at
        if lost:
            self._restored()

    def age(self) -> float | None:
        """Return the age of the newest sample in seconds; None before the first."""
        return None if self._at is None else time.monotonic() - self._at

    def is_fresh(self, max_age: float | None = None) -> bool:
        """Return whether the newest sample is recent enough."""
        age = self.age()
        return age is not None and age <= (max_age or self.max_age)

    def missing(self) -> str:
        """Describe what is missing."""
        age = self.age()
        return f"no feedback on {self.topic} " + ("yet" if age is None else f"for {age:.1f} s")

    def state(self, since: float | None = None) -> MotionState:
        """Report the measured state; with `since`, only what was measured later counts."""
        at, rest, (speed, turn) = self._measured_at, self._rest, self._speed
        if not self.is_fresh():
            return MotionState(None, self.missing())
        if rest is None:
            moving = f"{speed:.2f} m/s" if speed > self._limits[0] else f"{turn:.2f} rad/s"
            return MotionState(False, f"moves at {moving} ({self.topic})")
        if at - max(rest, since or rest) < _SETTLE:
            return MotionState(False, f"coming to rest ({self.topic})")
        return MotionState(True)


class Feedbacks:
    """The topics with a measured velocity."""

    def __init__(self, link: RosLink, restored: Callable[[str | None], None]) -> None:
        self._link = link
        self._restored = restored
        """Called on the event loop with a robot whose feedback has returned."""
        self._all: dict[tuple[str, str | None], Feedback] = {}

    def follow(self, topic: str, robot: str | None, type_: str | None) -> Feedback:
        """Subscribe to a topic for a robot once its type is known; called on the event loop."""
        stop = self._link.config.stop
        key = (topic, robot)
        found = self._all.get(key)
        if found is None:
            host = self._link.host
            found = self._all[key] = Feedback(
                topic,
                robot,
                (stop.speed, stop.turn),
                stop.max_age,
                lambda: host.call_soon(self._restored, robot),
                self._link.ticks if self._link.config.use_sim_time else Delays(),
            )
        if type_ is not None and found.type != type_:
            try:
                cls, tap = found.tap(type_)
            except (MissingType, ValueError) as error:
                self._link.trouble(f"feedback {topic}", f"{topic}: {error}")
                return found
            ros, subscriptions = self._link.ros, self._link.subscriptions
            ros.post(subscriptions.untap, topic, tap.name)
            ros.post(subscriptions.tap, topic, cls, Qos(), tap)
        return found

    def drop(self, robots: Iterable[str | None]) -> None:
        """Unsubscribe for robots that have been removed."""
        gone = set(robots)
        for key in [key for key in self._all if key[1] in gone]:
            self._link.ros.post(
                self._link.subscriptions.untap, key[0], f"feedback {key[0]} {key[1]}"
            )
            del self._all[key]

    def of(self, robot: str | None) -> list[Feedback]:
        """Return the feedback topics of a robot."""
        return [one for one in list(self._all.values()) if one.robot == robot]

    @property
    def robots(self) -> set[str | None]:
        """The robots with feedback."""
        return {robot for _, robot in self._all}

    def find(self, topic: str, robot: str | None) -> Feedback | None:
        """Return the feedback of a topic for a robot."""
        return self._all.get((topic, robot))
