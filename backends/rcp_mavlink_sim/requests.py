"""A received command, and its sender as far as commands need it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from rcp_mavlink_sim.streams import Streams
from rcp_mavlink_sim.vehicle import Vehicle
from rcp_mavlink_sim.wire import mav

__all__ = ["CommandRequest", "Peer", "outcome"]


class Peer(Protocol):
    """The sender of a command, as far as commands need it."""

    vehicle: Vehicle
    streams: Streams

    def send(self, message: Any) -> None:
        """Send a message to it with the next batch."""

    def later(self, do: Callable[[], None]) -> None:
        """Run something after the reply has been sent."""


class CommandRequest(msgspec.Struct, frozen=True):
    """A received command, LONG or INT."""

    peer: Peer
    number: int
    p: tuple[float, float, float, float, float, float, float]
    """Its parameters; latitude and longitude in degrees."""
    frame: int
    whole: bool
    """Whether it came as COMMAND_INT."""
    sender: tuple[int, int]


def outcome(done: bool) -> int:  # noqa: FBT001 - the outcome, as a result code
    """Return the MAV_RESULT of something that was done, or that failed."""
    return mav.MAV_RESULT_ACCEPTED if done else mav.MAV_RESULT_FAILED
