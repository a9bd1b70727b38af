"""The safe value of an actuator topic, and its other publishers.

A subscriber follows the last publisher, so a stop must keep publishing while others do. Everything
here runs in the ROS thread, except for the queries.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable
from rcp_ros2.cdr import Codec, Malformed, Value
from rcp_ros2.config import Qos
from rcp_ros2.idl import full_name
from rcp_ros2.link import RosLink
from rcp_ros2.outlet import Outlet
from rcp_ros2.pulse import node_of
from rcp_ros2.topics import Tap

__all__ = ["Rest"]

_QUIET = 0.5  # s without a foreign command, after which other publishers count as silent
_FASTEST = 100.0  # Hz
_AHEAD = 3.0  # repetition rate relative to other publishers
_BURST = 5  # transmissions in quick succession at first: some may be lost
_QUICK = 0.015  # s between two of those
_ANSWER = 0.002  # s between two replies to foreign commands, at least
_KNOWN = 20  # foreign commands used to compute their rate


class Rest:
    """The safe value of one actuator, repeated while its robot is stopped."""

    def __init__(
        self,
        link: RosLink,
        topic: str,
        cls: Any,
        outlet: Outlet,
        message: Any,
        *,
        wake: Callable[[], None],
    ) -> None:
        self.topic = topic
        self.type = full_name(cls)
        self.robot: str | None = None
        self.needed = True
        """Whether a stop needs a receiving node to be confirmed."""
        self.measured = False
        """Whether the configuration names its feedback."""
        self.others: tuple[str, ...] = ()
        """The other nodes that publish on the topic."""
        self.commanded = False
        """Whether the gateway's last message was not the safe value."""
        self.delivered_at: float | None = None
        """Monotonic time when the safe value was last published to a receiving node."""
        self.data = message if isinstance(message, bytes) else _serialised(message)
        """The safe value in CDR."""
        self.outlet = outlet
        self._link = link
        self._wake = wake
        """Repeats the stop of held robots."""
        self._cls = cls
        self._message = message
        self._codec = Codec(cls)
        self._plain = _plain(self._codec.decode(self.data))
        self._tap: Tap | None = None
        self._due = 0.0
        self._burst = 0
        """Remaining transmissions in quick succession."""
        self._answered = float("-inf")
        self._foreign: deque[float] = deque(maxlen=_KNOWN)
        """Times of foreign commands, monotonic."""
        self.acked = False
        """Whether every reliable subscriber has acknowledged the messages published so far."""

    # -- queries, from any thread ----------------------------------------------------------------

    def contested(self) -> float:
        """Return the rate in Hz of differing commands from other nodes; 0 if there are none."""
        times = list(self._foreign)
        if not times or time.monotonic() - times[-1] > _QUIET:
            return 0.0
        span = times[-1] - times[0]
        return (len(times) - 1) / span if span > 0 else 1 / _QUIET

    def about_others(self) -> str | None:
        """Describe the other publishers, or return None."""
        if not self.others:
            return None
        rate = self.contested()
        names = ", ".join(self.others)
        if rate:
            return f"{names} publishes on {self.topic} at {rate:.0f} Hz"
        return f"{names} may publish on {self.topic} too"

    # -- ROS thread ------------------------------------------------------------------------------

    def sent(self, *, rests: bool, published: bool, delivered: bool) -> None:
        """Record a message published by the gateway."""
        if not published:
            return
        now = time.monotonic()
        if rests and delivered:
            self.delivered_at = now
        if rests and self.commanded:  # the dead-man, or a client that stops commanding
            self._burst, self._due = _BURST - 1, now + _QUICK
            self._wake()
        elif not rests:
            self._burst = 0
        self.commanded = not rests

    def begin(self, now: float) -> None:
        """Publish the safe value, and repeat it in quick succession."""
        self._burst = _BURST
        self.publish(now)

    @property
    def is_bursting(self) -> bool:
        """Whether quick repetitions remain, held or not."""
        return self._burst > 0

    def publish(self, now: float) -> None:
        """Publish the safe value."""
        if self._burst > 0:
            self._burst -= 1
        rate = min(_FASTEST, max(self._link.config.stop.rate, _AHEAD * self.contested()))
        self._due = now + (_QUICK if self._burst else 1 / rate)
        try:
            self.acked = self.outlet.acked()
            delivered = self.outlet.send(self._message, anyhow=True)
        except AdapterUnavailable:  # reported as a problem of the outlet
            return
        self.commanded = False
        if delivered != "nobody":
            self.delivered_at = now

    def hold(self, now: float) -> None:
        """Publish the safe value again when it is due."""
        if now >= self._due:
            self.publish(now)

    def poll(self) -> None:
        """Detect other publishers and subscribe to their commands."""
        node = self._link.ros.node
        found = Counter(
            node_of(endpoint) or "an unnamed node"
            for endpoint in node.get_publishers_info_by_topic(self.topic)
        )
        own = node.get_fully_qualified_name()
        found[own] -= sum(publisher.topic_name == self.topic for publisher in node.publishers)
        self.others = tuple(sorted(name for name, count in found.items() if count > 0))

    @property
    def counters(self) -> bool:
        """Whether it counters foreign commands."""
        return self._tap is not None

    def listen(self) -> None:
        """Subscribe to foreign commands while the robot is stopped, to counter each of them."""
        if self.others and self._tap is None:
            self._foreign.clear()
            self._tap = Tap(f"stop {self.topic} {id(self)}", self._codec, taker=self._on_message)
            self._link.subscriptions.tap(self.topic, self._cls, Qos(), self._tap)

    def leave(self) -> None:
        """Unsubscribe."""
        if self._tap is not None:
            self._link.subscriptions.untap(self.topic, self._tap.name)
            self._tap = None
            self._foreign.clear()

    def _on_message(self, value: Value) -> None:
        if self._tap is None or value.data == self.data or self.is_rest(value.data):
            return
        now = time.monotonic()
        self._foreign.append(now)
        if now - self._answered >= _ANSWER:  # the robot follows the last command
            self._answered = now
            self.publish(now)

    def is_rest(self, data: bytes) -> bool:
        """Return whether a message equals the safe value, apart from its header."""
        try:
            return _plain(self._codec.decode(data)) == self._plain
        except Malformed:
            return False


def _plain(value: Any) -> Any:
    plain = msgspec.to_builtins(value)
    plain.pop("header", None)
    return plain


def _serialised(message: Any) -> bytes:
    from rclpy.serialization import serialize_message

    return serialize_message(message)
