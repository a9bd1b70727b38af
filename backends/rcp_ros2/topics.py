"""Subscriptions: one per topic, shared by all its paths.

Everything here runs in the ROS thread.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog

from rcp_ros2.cdr import Codec, Value
from rcp_ros2.config import Qos
from rcp_ros2.idl import full_name
from rcp_ros2.losses import Losses
from rcp_ros2.outbox import Outbox
from rcp_ros2.qos import Profile, clash, for_subscription
from rcp_ros2.ros import Ros, contained

__all__ = ["PROFILE", "Tap", "TopicSubscription", "TopicSubscriptions"]

log = structlog.get_logger("rcp.ros2")
_LARGE = 262_144  # bytes: two such messages fill the default shared memory of Fast DDS
_PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
PROFILE = Path(__file__).with_name("fastdds.xml")
"""Fast DDS profile with enough shared memory for images and point clouds."""
_OFF = 2.0  # s between a stamp and the gateway's clock that is reported
_RECENT = 2.0  # s since a message arrived by which that is judged
_SWEEP = 0.02  # s between two checks for held values that are due


@dataclass(slots=True)
class Tap:
    """One path that uses a topic."""

    name: str
    codec: Codec
    taker: Callable[[Value], None] | None = None
    """Called with each value instead of the outbox."""
    period: float = 0.0
    """Minimum time in s between two values; 0 takes all."""
    due: float = float("-inf")
    held: bytes | None = None
    """The newest value that arrived too early; published when it is due."""


@dataclass(slots=True)
class TopicSubscription:
    """One subscription."""

    topic: str
    cls: Any
    wanted: Qos
    taps: dict[str, Tap] = field(default_factory=dict[str, Tap])
    profile: Profile | None = None
    handle: Any = None
    losses: Losses | None = None
    last: bytes | None = None
    """The newest message."""
    arrived: float = float("-inf")
    """When it arrived, monotonic time; -inf before the first."""
    advised: bool = False
    """Whether the warning about large messages was reported."""


class TopicSubscriptions:
    """All subscriptions of a backend."""

    def __init__(
        self, ros: Ros, outbox: Outbox, complain: Callable[[str, str | None], None]
    ) -> None:
        self._ros = ros
        self._outbox = outbox
        self._complain = complain
        self.by_topic: dict[str, TopicSubscription] = {}
        """The open subscriptions, for the executor's thread."""
        self._sweeper: Any = None
        self.now: Callable[[], int | None] = lambda: None
        """The time of messages without a stamp, ns; None uses the time of receipt."""

    def tap(self, topic: str, cls: Any, qos: Qos, tap: Tap) -> None:
        """Subscribe a path to a topic, or change its rate."""
        subscription = self.by_topic.get(topic)
        if subscription is None:
            subscription = self.by_topic[topic] = TopicSubscription(topic, cls, qos)
        elif subscription.cls is not cls:  # the topic has a new type, and so have its other paths
            self._drop(subscription)
            subscription.taps.clear()
            subscription.cls, subscription.last, subscription.profile = cls, None, None
        known = subscription.taps.get(tap.name)
        if known is not None:
            known.period, known.due = tap.period, float("-inf")
        else:
            subscription.taps[tap.name] = tap
            if (
                subscription.last is not None
                and subscription.profile is not None
                and subscription.profile.latched
                and tap.codec.concerns(subscription.last)
            ):
                self._send(tap, subscription.last, 0.0)  # the middleware does not send it again
        self._match(subscription)
        self._keep_sweeping()

    def untap(self, topic: str, name: str) -> None:
        """Unsubscribe a path; the last one ends the subscription."""
        subscription = self.by_topic.get(topic)
        if subscription is None or subscription.taps.pop(name, None) is None or subscription.taps:
            return
        del self.by_topic[topic]
        self._drop(subscription)
        self._complain(topic, None)
        self._complain(f"clock of {topic}", None)
        self._complain(f"losses of {topic}", None)
        self._keep_sweeping()

    def renew(self, topic: str) -> None:
        """Subscribe anew, so that every publisher sends its latched message again."""
        subscription = self.by_topic.get(topic)
        if subscription is not None:
            self._drop(subscription)
            self._match(subscription)

    def refresh(self) -> None:
        """Match publishers that have appeared in the meantime."""
        for subscription in self.by_topic.values():
            self._match(subscription)
            if subscription.losses is not None:
                problem = subscription.losses.problem()
                self._complain(f"losses of {subscription.topic}", problem)
            if not self._ros.config.use_sim_time:
                self._complain(f"clock of {subscription.topic}", _skew(subscription))

    def release(self) -> None:
        """Let go of the events, which keep their subscriptions and so the whole context."""
        for subscription in self.by_topic.values():
            if subscription.losses is not None:
                subscription.losses.close()
                subscription.losses = None

    def _match(self, subscription: TopicSubscription) -> None:
        found = self._ros.node.get_publishers_info_by_topic(subscription.topic)
        type_ = full_name(subscription.cls)
        publishers = [one for one in found if one.topic_type == type_]  # others are never received
        profile = for_subscription(publishers, subscription.wanted)
        if subscription.handle is None or (publishers and profile != subscription.profile):
            self._drop(subscription)
            subscription.profile = profile
            try:
                subscription.handle = _subscribe(
                    self._ros.node,
                    subscription.cls,
                    subscription.topic,
                    self.callback_for(subscription),
                    profile,
                )
                subscription.losses = Losses(
                    subscription.topic, subscription.handle.handle, profile.deadline
                )
            except Exception as error:  # a subscription of another type may still exist
                self._complain(
                    subscription.topic, f"{subscription.topic} cannot be subscribed to: {error}"
                )
                return
        assert subscription.profile is not None
        self._complain(
            subscription.topic, clash(subscription.topic, subscription.profile, publishers)
        )

    def _drop(self, subscription: TopicSubscription) -> None:
        if subscription.losses is not None:
            subscription.losses.close()
            subscription.losses = None
        if subscription.handle is not None:
            self._ros.node.destroy_subscription(subscription.handle)
            subscription.handle = None

    def callback_for(self, subscription: TopicSubscription) -> Callable[[bytes], None]:
        """Return what takes each message of a subscription, on the executor's thread."""
        taps = subscription.taps
        monotonic = time.monotonic

        def on_message(data: bytes) -> None:
            try:
                subscription.last = data
                if len(data) > _LARGE and not subscription.advised:
                    _advise(subscription, len(data))
                subscription.arrived = now = monotonic()
                for tap in taps.values():
                    if not tap.codec.concerns(data):
                        continue
                    if tap.period and now < tap.due:
                        tap.held = data
                    else:
                        self._send(tap, data, now)
            except Exception as error:  # an escaping exception would end the executor
                log.error("ros_callback_failed", topic=subscription.topic, exc_info=error)

        return on_message

    def _send(self, tap: Tap, data: bytes, now: float) -> None:
        tap.held = None
        if tap.period:
            # Schedule by the due time, not by the clock, or jitter would cost every other value.
            tap.due = max(tap.due, now - tap.period) + tap.period
        if tap.taker is not None:
            tap.taker(Value(data, tap.codec))
            return
        stamp = tap.codec.stamp(data)
        time_ = self.now() if stamp is None else stamp
        self._outbox.put(tap.name, Value(data, tap.codec), time_)

    def _keep_sweeping(self) -> None:
        needed = any(
            tap.period
            for subscription in self.by_topic.values()
            for tap in subscription.taps.values()
        )
        if needed and self._sweeper is None:
            self._sweeper = self._ros.node.create_timer(_SWEEP, contained(self._sweep))
        elif not needed and self._sweeper is not None:
            self._ros.node.destroy_timer(self._sweeper)
            self._sweeper = None

    def _sweep(self) -> None:
        now = time.monotonic()
        for subscription in self.by_topic.values():
            for tap in subscription.taps.values():
                if tap.held is not None and now >= tap.due:
                    self._send(tap, tap.held, now)


def _skew(subscription: TopicSubscription) -> str | None:
    """Describe a stamp that this machine's clock does not explain; a latched message may be old."""
    data, profile = subscription.last, subscription.profile
    age = time.monotonic() - subscription.arrived
    if data is None or profile is None or age > _RECENT or not subscription.taps:
        return None
    stamp = next(iter(subscription.taps.values())).codec.stamp(data)
    if stamp is None:
        return None
    late = time.time() - age - stamp / 1e9
    if abs(late) < _OFF or (profile.latched and late > 0):
        return None
    side = "behind" if late > 0 else "ahead of"
    return (
        f"the stamps of {subscription.topic} are more than {_OFF:g} s {side} the gateway's clock: synchronize "
        "the clocks of both machines, or set `use_sim_time` if it is a simulation"
    )


def _advise(subscription: TopicSubscription, size: int) -> None:
    subscription.advised = True
    if subscription.profile is None or subscription.profile.reliable or _PROFILES in os.environ:
        return
    log.warning(
        "ros_messages_may_be_lost",
        topic=subscription.topic,
        bytes=size,
        detail="best effort, and too large for the default shared memory of Fast DDS: most "
        "of them are lost unless the publishing node configures more",
        remedy=f"Start that node with {_PROFILES}={PROFILE}, or let it publish reliable.",
    )


def _subscribe(
    node: Any, cls: Any, topic: str, on_message: Callable[[bytes], None], profile: Profile
) -> Any:
    from rclpy.event_handler import SubscriptionEventCallbacks

    # No event handlers: destroying one under the events executor can crash rclpy (its #1644). The
    # graph explains a mismatch better, and `Losses` has the rest.
    return node.create_subscription(
        cls,
        topic,
        on_message,
        profile.to_ros(),
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        raw=True,
    )
