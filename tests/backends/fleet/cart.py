"""A robot that is told what to do, and remembers what it was told."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing import ScriptedRobot
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import quantity

__all__ = ["Cart"]


class Cart(ScriptedRobot):
    """Drives, and has an action that goes on without its client and one that does not."""

    def __init__(self, host: Host) -> None:
        goal: dict[str, Any] = {"input": quantity("m"), "output": quantity("m")}
        super().__init__(
            host,
            Resource(
                name="actuator/drive",
                description="Drives.",
                value=quantity("m/s"),
                valid_for=0.5,
                safe=0.0,
            ),
            Resource(name="sensor/count", description="Counts.", value=quantity("1"), history=1000),
            Resource(name="action/go", description="Goes on.", **goal),
            Resource(name="action/line", description="Waits.", policy="queue", **goal),
            Resource(name="action/tied", description="Ends.", outlives=False, **goal),
        )
