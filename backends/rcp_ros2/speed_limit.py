"""`param/speed_limit` with the topic on which Nav2's controllers take one."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, RcpError
from rcp_profiles import bounded
from rcp_ros2.binding import Binding, Shared
from rcp_ros2.cdr import Codec, Malformed, Value
from rcp_ros2.config import Mapping, Qos
from rcp_ros2.filler import filler
from rcp_ros2.idl import full_name
from rcp_ros2.made import is_made
from rcp_ros2.outlet import Hearing, Outlet
from rcp_ros2.pulse import node_of
from rcp_ros2.standard import defined, standard_value
from rcp_ros2.topics import Tap
from rcp_ros2.types import inward
from rcp_ros2.writer import writer

__all__ = ["NavigatorLimit"]

_LOWEST = 0.01  # m/s: to Nav2 a limit of zero is none
_UNLIMITED = 0.0
_RELIABLE = Qos(reliability="reliable")


class NavigatorLimit(Binding):
    """The limit that the navigator was told last, by whomever."""

    def __init__(
        self,
        shared: Shared,
        name: str,
        standard: str,
        mapping: Mapping,
        cls: Any,
        *,
        ceiling: Callable[[], Awaitable[float | None]],
    ) -> None:
        """Ask with `ceiling` for the controller's own highest speed, None if unknown."""
        type_name = full_name(cls)
        self.topic = mapping.target
        self._ceiling = ceiling
        self._codec = Codec(cls)
        self._plain = inward(cls)
        self._fill = writer(cls) if is_made(cls) else filler(cls)
        self._outlet = Outlet(shared, self.topic, cls, _RELIABLE)
        self._told: tuple[bool, float] | None = None
        """Whether it is a percentage, and the number; None: nobody was told since it runs."""
        self._hearers: dict[bytes, str] = {}
        """The other nodes that subscribe, by the id of their subscription."""
        self._watched = False
        self._announcing: asyncio.Future[None] | None = None
        resource = defined(
            name,
            standard,
            mapping,
            value=bounded(standard_value(standard), {"": (_LOWEST, None)}),
            native=type_name,
            meta={"topic": self.topic, "type": type_name},
            examples=(),
        )
        super().__init__(shared, resource, mapping)
        self.standard = standard
        self._tap = Tap(f"limit {self.topic}", self._codec, taker=self._take)
        shared.ros.post(shared.subscriptions.tap, self.topic, cls, Qos(), self._tap)
        shared.ros.post(self._poll)
        shared.on_poll.append(self._poll)

    async def read(self) -> float:
        """Return the limit that is in force.

        :raises AdapterUnavailable: the navigator was told none, and its own is not known.
        """
        told = self._told
        if told is not None and told[1] > _UNLIMITED and not told[0]:
            return told[1]
        ceiling = await self._ceiling()
        if ceiling is None:
            raise AdapterUnavailable(
                f"no speed limit was published on {self.topic} since the navigator started",
                remedy="Write one.",
            )
        share = told[1] / 100 if told is not None and told[1] > _UNLIMITED else 1.0
        return ceiling * share

    async def write(self, value: float) -> float:
        """Tell the navigator; completes when its node has received it.

        :raises AdapterUnavailable: no navigator receives it.
        :raises DeviceTimeout: it was not acknowledged.
        """
        ceiling = await self._ceiling()
        # Some controllers ignore a limit above their own speed, others exceed it.
        limit = _UNLIMITED if ceiling is not None and value >= ceiling else value
        message = self._fill(self._plain(percentage=False, speed_limit=limit))
        end = time.monotonic() + self.timeout
        await self.shared.until(self._is_heard, self.shared.settling)
        if await self.shared.ros.call(self._send, message) != "heard":
            raise AdapterUnavailable(
                f"no node that responds subscribes to {self.topic}",
                remedy="Start the robot's navigator.",
            )
        while not await self.shared.ros.call(self._outlet.acked):
            if time.monotonic() >= end:
                raise self.late(f"the subscriber of {self.topic}")
        self._told = (False, limit)
        return value if ceiling is None else min(value, ceiling)

    def watched(self, rate: float) -> None:
        """Publish each limit that anybody tells the navigator."""
        if not self._watched:
            self._watched = True
            self._announce()

    def unwatched(self) -> None:
        """Stop publishing."""
        self._watched = False

    def _is_heard(self) -> bool:
        return bool(self.shared.graph.subscribers.get(self.topic))

    # -- ROS thread ------------------------------------------------------------------------------

    def _send(self, message: Any) -> Hearing:
        self._poll()
        return self._outlet.send(message, anyhow=False)

    def _poll(self) -> None:
        """Match the subscribers; a node that was restarted was told nothing yet."""
        self._outlet.poll()
        node = self.shared.ros.node
        own = node.get_fully_qualified_name()
        found = {
            bytes(one.endpoint_gid): name
            for one in node.get_subscriptions_info_by_topic(self.topic)
            if (name := node_of(one)) is not None and name != own
        }
        before = set(self._hearers.values())
        if any(name in before for gid, name in found.items() if gid not in self._hearers):
            self._told = None
        self._hearers = found or self._hearers  # of one that is gone, the names are kept

    def _take(self, value: Value) -> None:
        try:
            found = value.decode()
        except Malformed:
            return
        self._told = (found.percentage, found.speed_limit)
        if self._watched:
            self.shared.host.call_soon(self._announce)

    # -- event loop ------------------------------------------------------------------------------

    def _announce(self) -> None:
        self._announcing = asyncio.ensure_future(self._publish())

    async def _publish(self) -> None:
        with contextlib.suppress(RcpError):
            self.shared.host.publish(self.resource.name, await self.read())

    def close(self) -> None:
        """Destroy the publisher."""
        if self._poll in self.shared.on_poll:
            self.shared.on_poll.remove(self._poll)
        self.shared.ros.post(self.shared.subscriptions.untap, self.topic, self._tap.name)
        self.shared.ros.post(self._outlet.close)
