"""A CAN bus that crosses processes: multicast on the loopback interface, a group per test."""

from __future__ import annotations

import random
from typing import Any

import can

__all__ = ["group", "line"]


def group() -> str:
    """Return a multicast group that hardly anybody else uses."""
    return f"239.{random.randrange(64, 128)}.{random.randrange(256)}.{random.randrange(1, 255)}"


def line(channel: str, **more: Any) -> can.BusABC:
    """Open the bus of a group."""
    return can.Bus(channel, "udp_multicast", ignore_config=True, **{"fd": False, **more})
