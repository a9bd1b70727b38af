"""Subscribed topics (sensors, events) and published topics (actuators)."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
from msgspec import structs

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout
from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Shared, common
from rcp_ros2.cdr import Codec, Value, is_stamped
from rcp_ros2.comments import comments_of, first_sentence
from rcp_ros2.config import Mapping
from rcp_ros2.filler import filler
from rcp_ros2.idl import fields_of, full_name
from rcp_ros2.made import is_made
from rcp_ros2.native import native_type
from rcp_ros2.outlet import Hearing, Outlet
from rcp_ros2.rest import Rest
from rcp_ros2.ros import Ticket
from rcp_ros2.topics import Tap
from rcp_ros2.types import example_of, framed, inward, part_of
from rcp_ros2.writer import writer

__all__ = ["Commanded", "Form", "Observed"]

_VELOCITY = {
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovariance",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/Accel",
    "geometry_msgs/msg/AccelStamped",
    "geometry_msgs/msg/Wrench",
    "geometry_msgs/msg/WrenchStamped",
    "ackermann_msgs/msg/AckermannDrive",
    "ackermann_msgs/msg/AckermannDriveStamped",
    "control_msgs/msg/JointJog",
}
_DEADMAN = 0.5  # s for which a velocity is valid unless the mapping says otherwise
_MATCH = 1.0  # s for a publisher to discover a subscriber that the graph lists
_MARGIN = 1.0  # s that the gateway waits longer than a read may take
_PAUSE = 0.05  # s between two checks of discovery


class Observed(Binding):
    """A sensor or event, subscribed while a client subscribes; events always."""

    def __init__(
        self, shared: Shared, resource: Resource, mapping: Mapping, cls: Any, codec: Codec
    ) -> None:
        self.topic = mapping.target
        self._cls = cls
        self.codec = codec
        super().__init__(shared, resource, mapping)
        if resource.live:  # a missed event could not be read later
            self.watched(math.inf)

    @classmethod
    def of(cls, shared: Shared, name: str, mapping: Mapping, message: Any) -> Observed:
        """Create the sensor or event of a topic from its mapping."""
        codec = Codec(message, mapping.field, mapping.unit)
        type_name = full_name(message)
        facts = common(
            name,
            mapping,
            _about(message, mapping),
            topic=mapping.target,
            type=type_name,
            field=mapping.field,
        )
        facts["timeout"] = (mapping.timeout or shared.config.timeout) + _MARGIN
        live = name.startswith("event/")
        resource = Resource(
            value=framed(codec.type, mapping.frame),
            native=type_name,
            native_types={"value": native_type(message)},
            live=live,
            **facts,
        )
        return cls(shared, resource, mapping, message, codec)

    def watched(self, rate: float) -> None:
        """Subscribe, or change the rate."""
        self.tap(Tap(self.resource.name, self.codec, period=self.period(rate)))

    def period(self, rate: float) -> float:
        """Return the time in s between two values for a rate that is wanted; 0 for all."""
        rate = min(rate, self.mapping.rate or math.inf)
        return 0.0 if rate == math.inf else 1 / rate

    def tap(self, tap: Tap) -> None:
        """Add a path that uses the topic, this one or a derived one."""
        self.shared.ros.post(
            self.shared.subscriptions.tap, self.topic, self._cls, self.mapping.qos, tap
        )

    def untap(self, name: str) -> None:
        """Remove a path from the subscription."""
        self.shared.ros.post(self.shared.subscriptions.untap, self.topic, name)

    def unwatched(self) -> None:
        """End the subscription, unless it is an event's."""
        if not self.resource.live:
            self.close()

    def close(self) -> None:
        """End the subscription."""
        self.untap(self.resource.name)

    async def read(self) -> Any:
        """Return the next value, or the latched value.

        :raises AdapterUnavailable: no node publishes the topic, or no event has been received yet.
        :raises DeviceTimeout: no message arrived in time.
        """
        return (await self.measured())[0]

    async def measured(self) -> tuple[Any, int | None]:
        """Return the value of `read` with the stamp of its message, or the robot's simulated time."""
        value = await self.following()
        stamp = self.codec.stamp(value.data)
        return value.decode(), self.shared.subscriptions.now() if stamp is None else stamp

    async def following(self) -> Value:
        """Return the value of `read` in serialized form."""
        if self.resource.live:  # the kernel would have returned the last one
            raise AdapterUnavailable(
                f"no message received on {self.topic} yet",
                remedy="Subscribe to it to receive the next one.",
            )
        shared = self.shared
        if not await shared.until(self._is_published, shared.settling):
            raise AdapterUnavailable(
                f"no node publishes {self.topic}",
                remedy="Start the node that publishes it; the gateway discovers it automatically.",
            )
        next_ = Ticket(shared.host)
        tap = Tap(f"{self.resource.name} read {id(next_)}", self.codec, taker=next_.give)
        await shared.ros.call(
            shared.subscriptions.tap, self.topic, self._cls, self.mapping.qos, tap
        )
        try:
            if not await next_.wait(self.timeout):
                raise DeviceTimeout(
                    f"no message received on {self.topic} within {self.timeout:g} s",
                    remedy="Check that its publisher is running; subscribe to wait longer.",
                )
            return next_.result()
        finally:
            self.untap(tap.name)

    def _is_published(self) -> bool:
        return bool(self.shared.graph.publishers.get(self.topic))


def _about(message: Any, mapping: Mapping) -> str:
    type_name, field = full_name(message), mapping.field
    if field is None:
        return f"{type_name} on topic {mapping.target}{_suffix(comments_of(message).whole)}."
    holder = part_of(message, field)[0]
    suffix = _suffix(comments_of(holder).fields.get(field.rpartition(".")[2], ""))
    return f"{field} of {type_name} on topic {mapping.target}{suffix}."


def _suffix(comment: str) -> str:
    sentence = first_sentence(comment)
    return f": {sentence[0].lower()}{sentence[1:]}" if sentence else ""


class Form(NamedTuple):
    """The values of an actuator, and how each becomes a message."""

    type: Any
    fill: Callable[[Any], Any]


def _whole(cls: Any, mapping: Mapping) -> Form:
    """Return the form of a whole message; if its header has no frame, it gets that of the mapping."""
    type_ = inward(cls, mapping.unit, nan=mapping.nan)
    fill = writer(cls) if is_made(cls) else filler(cls)
    frame = mapping.frame
    if frame is None or not is_stamped(cls):
        return Form(type_, fill)
    [header, *_] = fields_of(cls)

    def framed(value: Any) -> Any:
        given = getattr(value, header.name)
        if given.frame_id:
            return fill(value)
        return fill(structs.replace(value, **{header.name: structs.replace(given, frame_id=frame)}))

    return Form(type_, framed)


class Commanded(Binding):
    """An actuator: written values are published."""

    def __init__(
        self, shared: Shared, name: str, mapping: Mapping, cls: Any, form: Form | None = None
    ) -> None:
        """Accept values of the message's type, or those of a `form`."""
        self.topic = mapping.target
        own = form or _whole(cls, mapping)
        self._type, self._fill = own.type, own.fill
        self._outlet = Outlet(shared, self.topic, cls, mapping.qos)
        self._written: Any = None
        type_name = full_name(cls)
        velocity = type_name in _VELOCITY
        valid_for = _DEADMAN if mapping.valid_for is None and velocity else mapping.valid_for
        self._safe = self._rest(mapping) if velocity or valid_for or mapping.safe else None
        resource = Resource(
            value=framed(self._type, mapping.frame),
            valid_for=valid_for or None,
            safe=self._safe,
            native=type_name,
            native_types={"value": native_type(cls)},
            examples=example_of(self._type),
            **common(
                name,
                mapping,
                f"Publishes {type_name} on topic {self.topic}{_suffix(comments_of(cls).whole)}.",
                topic=self.topic,
                type=type_name,
            ),
        )
        super().__init__(shared, resource, mapping)
        self.rest: Rest | None = None
        if self._safe is not None and self.is_barred:
            message = self._fill(self._safe)
            self.rest = Rest(
                shared, self.topic, cls, self._outlet, message, wake=shared.keeper.wake
            )
            self.rest.needed = mapping.require_subscriber
        shared.ros.post(self._outlet.poll)
        shared.on_poll.append(self._outlet.poll)

    def placed(self) -> None:
        """Include the actuator in stops of its robot from now on."""
        if self.rest is not None:
            self.rest.robot = self.resource.robot
            self.shared.ros.post(self.shared.keeper.add, self.rest)

    def _rest(self, mapping: Mapping) -> Any:
        return self._type() if mapping.safe is None else msgspec.convert(mapping.safe, self._type)

    async def write(self, value: Any) -> None:
        """Publish a value; the safe value is sent even if no node receives it.

        :raises AdapterUnavailable: no node receives it, or none that responds.
        """
        shared, need = self.shared, self.mapping.require_subscriber
        message = self._fill(value)
        rests = self._safe is not None and value == self._safe
        if need:
            await shared.until(self._listened_to, shared.settling)
        if not rests:
            await self._need_feedback()
        hearing = await shared.ros.call(self._send, message, rests, rests or not need)
        if hearing == "nobody" and need and self._listened_to():
            hearing = await self._until_matched(message, rests=rests)
        if hearing != "heard" and need:
            raise self._unheard(hearing)
        self._written = value

    async def _need_feedback(self) -> None:
        """Wait until the feedback of the motion arrives.

        :raises AdapterUnavailable: it is missing or too old, so the robot cannot be controlled.
        """
        if self.mapping.feedback is None:
            return

        def delivered() -> bool:
            return self.feedback is not None and self.feedback.is_fresh()

        if not await self.shared.until(delivered, self.shared.settling):
            why = self.feedback.missing() if self.feedback is not None else "no feedback yet"
            raise AdapterUnavailable(
                f"{why}: {self.topic} accepts no commands without feedback",
                remedy="Check the node that publishes it.",
            )

    def check_feedback_while_moving(self) -> None:
        """Stop the actuator if its feedback is lost."""
        feedback, rest = self.feedback, self.rest
        if feedback is None or rest is None:
            return
        lost = not feedback.is_fresh()
        if lost and rest.commanded:
            self.shared.ros.post(lambda: rest.begin(time.monotonic()))
            text = f"{feedback.missing()}: {self.topic} was stopped"
            self.shared.trouble(f"feedback of {self.topic}", text)
            self.shared.report()
        elif not lost:
            self.shared.trouble(f"feedback of {self.topic}", None)

    def _unheard(self, hearing: Hearing) -> AdapterUnavailable:
        if hearing == "silent":
            return AdapterUnavailable(
                f"the node that subscribes to {self.topic} no longer responds",
                remedy="Check the robot's node; it may have crashed or be blocked.",
            )
        return AdapterUnavailable(
            f"no node subscribes to {self.topic}: the command would be lost",
            remedy="Start the robot's node, or set `require_subscriber = false` in its mapping.",
        )

    async def read(self) -> Any:
        """Return the last written value.

        :raises AdapterUnavailable: nothing has been written.
        """
        if self._written is None:
            raise AdapterUnavailable(
                f"nothing has been written to {self.resource.name} yet",
                remedy="Write a value first; commands of other publishers are not visible here.",
            )
        return self._written

    def _listened_to(self) -> bool:
        return bool(self.shared.graph.subscribers.get(self.topic))

    def _send(self, message: Any, rests: bool, anyhow: bool) -> Hearing:  # noqa: FBT001 - called by the thread
        if not rests:
            self.admit()
        hearing = self._outlet.send(message, anyhow=anyhow)
        if self.rest is not None:
            unheard = hearing != "heard" and not anyhow
            self.rest.sent(rests=rests, published=not unheard, delivered=hearing != "nobody")
        return hearing

    async def _until_matched(self, message: Any, *, rests: bool) -> Hearing:
        """Retry while a subscriber that the graph lists may still be matched."""
        for _ in range(int(_MATCH / _PAUSE)):
            hearing: Hearing = await self.shared.ros.call(self._send, message, rests, False)
            if hearing != "nobody":
                return hearing
            await asyncio.sleep(_PAUSE)
        return "nobody"

    def close(self) -> None:
        """Destroy the publisher."""
        if self._outlet.poll in self.shared.on_poll:
            self.shared.on_poll.remove(self._outlet.poll)
        if self.rest is not None:
            self.shared.ros.post(self.shared.keeper.remove, self.rest)
        self.shared.ros.post(self._outlet.close)
