"""Publishers: one per actuator, matched with its subscribers."""

from __future__ import annotations

import contextlib
import struct
from typing import Any, Literal

from rcp_kernel.errors import AdapterUnavailable
from rcp_ros2.cdr import is_stamped
from rcp_ros2.config import Qos
from rcp_ros2.idl import fields_of
from rcp_ros2.link import RosLink
from rcp_ros2.pulse import node_of
from rcp_ros2.qos import Profile, for_publisher, unreached_subscribers

__all__ = ["Hearing", "Outlet"]

_STAMP = slice(4, 12)
"""Where serialized messages that begin with a header have its stamp."""
Hearing = Literal["heard", "nobody", "silent"]
"""Who receives what is sent; `silent` means nodes that responded before and no longer do."""


class Outlet:
    """One publisher; recreated if a subscriber requests latched values."""

    def __init__(self, link: RosLink, topic: str, cls: Any, wanted: Qos) -> None:
        self._node = lambda: link.ros.node
        fields = fields_of(cls) if is_stamped(cls) else ()
        self._header = fields[0].name if fields else None
        self._stamp = link.stamp
        self._pulses = link.pulses
        self._complain = link.complain
        self._topic = topic
        self._cls = cls
        self._wanted = wanted
        self._profile: Profile | None = None
        self._publisher: Any = None
        self._nodes: frozenset[str] = frozenset()

    def poll(self) -> None:
        """Match the current subscribers early, so that the first command reaches them."""
        with contextlib.suppress(AdapterUnavailable):  # reported as a problem
            self.match()

    def match(self) -> None:
        """Match the current subscribers.

        :raises AdapterUnavailable: the middleware refuses; a topic has only one type in a process.
        """
        from rclpy.event_handler import PublisherEventCallbacks

        node = self._node()
        endpoints = node.get_subscriptions_info_by_topic(self._topic)
        named = {name for name in map(node_of, endpoints) if name is not None}
        self._nodes = frozenset(named - {node.get_fully_qualified_name()})  # it may subscribe too
        self._pulses.want(f"topic {self._topic}", self._nodes)
        profile = for_publisher(endpoints, self._wanted)
        self._complain(
            f"publisher {self._topic}", unreached_subscribers(self._topic, profile, endpoints)
        )
        if profile == self._profile:
            return
        self._drop()
        self._profile = profile
        try:
            self._publisher = node.create_publisher(
                self._cls,
                self._topic,
                profile.to_ros(),
                event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            )
        except Exception as error:
            self._profile = None
            why = f"cannot publish {self._topic}: {error}"
            self._complain(f"publisher {self._topic}", why)
            raise AdapterUnavailable(why) from error

    def send(self, message: Any, *, anyhow: bool) -> Hearing:
        """Publish if there is a subscriber or `anyhow` is set; return who receives it."""
        if self._publisher is None:
            self.match()
        assert self._publisher is not None
        hearing = self._hearing()
        if hearing == "heard" or anyhow:
            self._publish(message)
        return hearing

    def _publish(self, message: Any) -> None:
        """Publish a message; one without a stamp gets the time, and repeated another one each time."""
        if self._header is None:
            self._publisher.publish(message)
        elif isinstance(message, bytes):
            self._publisher.publish(self._stamped(message))
        else:
            header = getattr(message, self._header)
            given = header.stamp
            if given.sec == given.nanosec == 0:
                header.stamp = self._stamp()
            self._publisher.publish(message)
            header.stamp = given

    def _stamped(self, data: bytes) -> bytes:
        if any(data[_STAMP]):
            return data
        now, order = self._stamp(), "<" if data[1] else ">"
        return (
            data[: _STAMP.start]
            + struct.pack(f"{order}iI", now.sec, now.nanosec)
            + data[_STAMP.stop :]
        )

    @property
    def nodes(self) -> frozenset[str]:
        """The nodes that subscribed at the last poll."""
        return self._nodes

    @property
    def reliable(self) -> bool:
        """Whether it is published reliably."""
        return self._profile is None or self._profile.reliable

    def acked(self) -> bool:
        """Return whether all reliable subscribers have acknowledged everything published so far."""
        from rclpy.duration import Duration

        if self._publisher is None:
            return False
        try:
            return self._publisher.wait_for_all_acked(Duration(nanoseconds=0))
        except Exception:  # a middleware without acknowledgements
            return True

    def count(self) -> int:
        """Return the number of matched subscribers of other nodes."""
        if self._publisher is None:
            return 0
        own = sum(one.topic_name == self._topic for one in self._node().subscriptions)
        return max(0, self._publisher.get_subscription_count() - own)

    def _hearing(self) -> Hearing:
        if not self.count():
            return "nobody"
        if self._nodes and all(map(self._pulses.is_silent, self._nodes)):
            return "silent"
        return "heard"

    def close(self) -> None:
        """Destroy the publisher."""
        self._pulses.want(f"topic {self._topic}", ())
        self._complain(f"publisher {self._topic}", None)
        self._drop()

    def _drop(self) -> None:
        if self._publisher is not None:
            self._node().destroy_publisher(self._publisher)
            self._publisher = self._profile = None
