"""The ROS 2 connection shared by all parts of a backend."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.spi import Host
from rcp_ros2.action_clients import ActionClients
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Qos, Ros2Config
from rcp_ros2.graph import Graph
from rcp_ros2.idl import MissingType, load
from rcp_ros2.naming import Naming
from rcp_ros2.outbox import Outbox
from rcp_ros2.pulse import Pulses
from rcp_ros2.ros import Ros
from rcp_ros2.stamps import Ticks
from rcp_ros2.topics import Tap, TopicSubscriptions

__all__ = ["RosLink"]

_DEPTH = 200  # queue depth for the messages of a construct, which come in bursts
_GOALS = 1000  # goals of the gateway whose ids are remembered
_PAUSE = 0.05  # s between two checks of a condition


class RosLink:
    """The node, the latest poll of its graph, the subscriptions and the active problems."""

    def __init__(self, ros: Ros, config: Ros2Config, host: Host) -> None:
        self.ros = ros
        self.config = config
        self.host = host
        self.graph = Graph()
        """The latest poll of the graph."""
        self.naming = Naming(config)
        self.outbox = Outbox(host)
        self._troubles: dict[str, str] = {}
        self._reported = False
        self._complaints: dict[str, str | None] = {}
        self.subscriptions = TopicSubscriptions(ros, self.outbox, self.complain)
        ros.on_close.append(self.subscriptions.release)
        self.pulses = Pulses(ros, self.complain)
        self.action_clients = ActionClients(ros)
        ros.on_close.append(self.action_clients.release)
        self.ticks = Ticks()
        """The times of `/clock`, if it is used."""
        self.on_poll: list[Callable[[], None]] = []
        """Called in the ROS thread with each poll of the graph."""
        self.refresh: Callable[[], None] = lambda: None
        """Creates the paths that a construct has found since the last poll. Called on the event loop."""
        self.needed: set[str] = set()
        """Names that are relevant although no path maps to them."""
        self.sent_goals: dict[bytes, None] = {}
        """Ids of goals sent by the gateway, newest last."""
        self._settled = time.monotonic() + config.grace

    @property
    def settling(self) -> float:
        """Remaining time in s for the discovery of the graph."""
        return max(0.0, self._settled - time.monotonic())

    def stamp(self) -> Any:
        """Return the robot's time for a header, zero while that of a simulation is unknown.

        Called in the ROS thread. Drivers judge the age of stamped commands by their own clock: to a
        simulated one, the time of the wall is far ahead and never too old.
        """
        if not self.config.use_sim_time:
            return self.ros.node.get_clock().now().to_msg()
        from builtin_interfaces.msg import Time

        sec, nanosec = divmod(self.subscriptions.now() or 0, 1_000_000_000)
        return Time(sec=sec, nanosec=nanosec)

    def trouble(self, key: str, detail: str | None) -> None:
        """Set or clear the problem with a key."""
        if detail is not None:
            self._troubles[key] = detail
        else:
            self._troubles.pop(key, None)

    def report(self) -> None:
        """Report all problems, or once that there are none."""
        detail = "; ".join(self._troubles.values()) or None
        if detail is not None or self._reported:
            self._reported = detail is not None
            self.host.report(detail)

    def sent(self, goal: bytes) -> None:
        """Remember the id of a goal sent by the gateway."""
        self.sent_goals[goal] = None
        if len(self.sent_goals) > _GOALS:
            del self.sent_goals[next(iter(self.sent_goals))]

    def complain(self, key: str, detail: str | None) -> None:
        """Set a problem from the ROS thread; only changes wake the event loop."""
        if self._complaints.get(key) != detail:
            self._complaints[key] = detail
            self.host.call_soon(self.trouble, key, detail)

    def listen(
        self,
        topic: str,
        type_: str,
        key: str,
        taker: Callable[[Any], None],
        qos: Qos = Qos(depth=_DEPTH),  # noqa: B008 - frozen
    ) -> None:
        """Call a function with each message of a topic; in the ROS thread.

        A type that is not installed is reported as a problem, with its remedy.
        """
        try:
            cls = load(type_)
        except MissingType as error:
            self.complain(key, f"{topic} cannot be subscribed to: {error}. {error.remedy}")
            return
        tap = Tap(key, Codec(cls), taker=lambda value: taker(value.decode()))
        self.subscriptions.tap(topic, cls, qos, tap)

    async def until(self, holds: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition on the graph holds, at most `seconds`; return whether it does."""
        end = time.monotonic() + seconds
        while not holds():
            if time.monotonic() >= end:
                return False
            await asyncio.sleep(_PAUSE)
        return True

    async def present(self, noun: str, name: str) -> None:
        """Wait until a node offers something.

        :raises AdapterUnavailable: no node does.
        """
        if self.graph.has(noun, name) or await self.until(
            lambda: self.graph.has(noun, name), self.settling
        ):
            return
        raise AdapterUnavailable(
            f"the {noun} {name} is not running"
            if noun.endswith("node")
            else f"no node offers {noun} {name}",
            remedy="Start the node that provides it; the gateway discovers it automatically.",
        )
