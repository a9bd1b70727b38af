"""The robot's time from `/clock`, if a simulator or a recording provides it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.cdr import Codec, Value
from rcp_ros2.config import Mapping, Qos
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.sensors import Observed
from rcp_ros2.topics import Tap

__all__ = ["Clock"]

_TOPIC = "/clock"
_TYPE = "rosgraph_msgs/msg/Clock"
_SENSOR, _EVENT = "sensor/clock", "event/clock_jump"
_QOS = Qos(reliability="best_effort", depth=1)

Time = Annotated[float, Meta(extra_json_schema={"unit": "s"})]


class ClockJump(msgspec.Struct, frozen=True):
    """The robot's time jumped back: a simulation was reset, or a recording restarted."""

    before: Time
    after: Time


class Clock:
    """Follows the robot's time and notifies listeners when it jumps back."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._mapping = Mapping(topic=_TOPIC, field="clock")
        self._wanted = shared.config.use_sim_time
        self.on_jump: list[Callable[[], None]] = []
        """Called in the ROS thread."""
        self.now: int | None = None
        """The robot's time, ns; used only in the ROS thread."""
        if self._wanted:
            shared.subscriptions.now = lambda: self.now
            shared.ros.post(self._open)

    def _open(self) -> None:
        cls = load(_TYPE)
        codec = Codec(cls, "clock")
        take = partial(self._take, codec)
        self._shared.subscriptions.tap(_TOPIC, cls, _QOS, Tap("clock", codec, taker=take))

    def _take(self, codec: Codec, value: Value) -> None:
        time = codec.decode(value.data)
        now = time.sec * 1_000_000_000 + time.nanosec
        before, self.now = self.now, now
        self._shared.ticks.add(now)
        if before is not None and now < before:
            for callback in self.on_jump:
                callback()
            jump = ClockJump(before / 1e9, now / 1e9)
            self._shared.host.call_soon(self._shared.host.publish, _EVENT, jump, now)

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the clock and its jumps, if configured."""
        if not self._wanted:
            return {}
        if not self._shared.settling:
            text = "`use_sim_time` is set, but no node publishes /clock"
            runs = graph.publishers.get(_TOPIC)
            self._shared.trouble("clock", None if runs else text)
        return {
            _SENSOR: Offer(self._mapping, self._sensor),
            _EVENT: Offer(self._mapping, partial(Jumps, self._shared, self._mapping)),
        }

    def _sensor(self) -> Binding:
        return Observed.of(self._shared, _SENSOR, self._mapping, load(_TYPE))


class Jumps(Binding):
    """The event of a jump back in time."""

    def __init__(self, shared: Shared, mapping: Mapping) -> None:
        text = "The robot's time went back: history kept by that time is cleared"
        facts = common(_EVENT, mapping, text, topic=_TOPIC)
        super().__init__(shared, Resource(value=ClockJump, live=True, **facts), mapping)

    async def read(self) -> Any:
        """Raise: no jump has happened yet, or the kernel would have returned the last one."""
        raise AdapterUnavailable(
            "the robot's time has not gone back so far",
            remedy="Subscribe to it to receive the next one.",
        )
