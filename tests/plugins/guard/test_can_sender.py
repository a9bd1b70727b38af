"""The guard on a CAN bus whose own queue is shorter than its plan."""

from __future__ import annotations

import errno
import time
from typing import Any

import can
import pytest

from rcp_guard.senders.can_bus import CanSender


class Socket:
    """A SocketCAN interface at 1 Mbit/s with its usual queue: when that is full, sending fails at once."""

    def __init__(self, takes: float) -> None:
        self.sent: list[int] = []
        self._leaves: list[float] = []
        self._takes = takes

    def send(self, message: can.Message, timeout: float) -> None:
        now = time.monotonic()
        self._leaves = [at for at in self._leaves if at > now]
        if len(self._leaves) >= 10:
            text = "Failed to transmit: No buffer space available"
            raise can.CanOperationError(text, errno.ENOBUFS)
        self._leaves.append(max([now, *self._leaves]) + self._takes)
        self.sent.append(message.arbitration_id)


def sender(bus: Any) -> CanSender:
    frames = [can.Message(arbitration_id=number) for number in range(24)]
    return CanSender(bus, frames, drained=False)


def test_each_drive_is_stopped_although_the_queue_holds_ten_frames() -> None:
    bus = Socket(130e-6)
    sender(bus).send()
    assert bus.sent == list(range(24))


def test_a_bus_that_takes_nothing_is_told_in_time() -> None:
    bus, began = Socket(60.0), time.monotonic()
    with pytest.raises(can.CanOperationError):
        sender(bus).send()
    assert bus.sent == list(range(10))
    assert time.monotonic() - began < 1.0
