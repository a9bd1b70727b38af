"""Messages that were lost between nodes, and deadlines that publishers missed.

The middleware counts both as events. No executor of rclpy gets them: destroying an event under the
events executor can end the process (rclpy issue 1644). They are taken when the graph is looked at.
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

from rcp_ros2.qos import EVER

__all__ = ["Losses"]

_SHOWN = 30.0  # s that a problem is shown after its last event


class _AlwaysReady:
    """In place of a wait set, for an event that is asked whether it happened."""

    def add_event(self, _event: Any) -> int:
        return 0

    def is_ready(self, _kind: str, _index: int) -> bool:
        return True


_READY = _AlwaysReady()


class Losses:
    """The events of one subscription; in the ROS thread."""

    def __init__(self, topic: str, handle: Any, deadline: int) -> None:
        """`handle` is that of the subscription, `deadline` what it requests, in ns."""
        self._topic = topic
        self._deadline = deadline
        self._lost = _event(handle, "RCL_SUBSCRIPTION_MESSAGE_LOST")
        self._late = None
        if deadline < EVER:
            self._late = _event(handle, "RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED")
        self._until: dict[str, float] = {}

    def problem(self) -> str | None:
        """Return what has happened lately; None: nothing."""
        now = time.monotonic()
        lost = (
            f"messages of {self._topic} are lost on their way here: check the network, or let it be "
            "published with `reliable` QoS"
        )
        late = f"{self._topic} missed its deadline of {self._deadline / 1e9:g} s"
        for event, text in ((self._lost, lost), (self._late, late)):
            if event is not None and _happened(event):
                self._until[text] = now + _SHOWN
        self._until = {text: end for text, end in self._until.items() if end > now}
        return "; ".join(self._until) or None

    def close(self) -> None:
        """Destroy the events, before their subscription."""
        for event in (self._lost, self._late):
            if event is not None:
                event.destroy()


def _event(handle: Any, name: str) -> Any:
    """Return an event of a subscription; None: the middleware does not have it."""
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.event_handler import (
        EventHandler,
        QoSSubscriptionEventType,
        UnsupportedEventTypeError,
    )

    with suppress(UnsupportedEventTypeError):
        event = EventHandler(
            callback_group=ReentrantCallbackGroup(),  # of its own: no executor sees it
            callback=lambda _data: None,
            event_type=getattr(QoSSubscriptionEventType, name),
            parent_impl=handle,
        )
        event.add_to_wait_set(_READY)  # pyright: ignore[reportArgumentType]
        return event
    return None


def _happened(event: Any) -> bool:
    event.is_ready(_READY)
    try:
        taken = event.take_data()
    except RuntimeError:  # as some middlewares say that nothing happened
        return False
    return taken is not None and taken.total_count_change > 0
