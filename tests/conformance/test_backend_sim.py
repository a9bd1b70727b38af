"""The simulated rover keeps what the house asks of a backend."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any, ClassVar

import rcp_sim
from hurry import Hurried
from rcp_gateway.testing import (
    BackendSuite,
    Body,
    Goal,
    ProfileSuite,
    StopRig,
    StopSuite,
    eventually,
)
from rcp_kernel.errors import RcpError
from rcp_sim.messages import FaultSpec

REST = (0.0, 0.0)


class SimRig(StopRig):
    kind = next(iter(rcp_sim.rcp_backends()))
    config: ClassVar[Mapping[str, Any]] = {
        "world": "empty",
        "noise": 0.0,
        "map_resolution": 0.5,
        "time_scale": 5.0,
    }

    async def truth(self, name: str) -> Any:
        sim = self.backend.device.sim
        if name == "param/speed_limit":
            return sim.limit
        v, w = sim.velocity
        return {"linear": {"x": v}, "angular": {"z": w}}

    async def confirms(self, name: str, result: Any) -> bool:
        rover = self.backend.device.sim.rover
        where = result["pose"]["position"]
        return abs(where["x"] - rover.x) < 0.1 and abs(where["y"] - rover.y) < 0.1

    async def at_rest(self) -> bool:
        return self.backend.device.sim.rover.at_rest

    def goals(self) -> Mapping[str, Goal]:
        here, far = {"position": {"x": 0.3, "y": 0.0}}, {"position": {"x": 15.0, "y": 0.0}}
        return {
            "action/move_to": Goal(good=here, bad={"position": {"x": 500.0, "y": 0.0}}, long=far),
            "action/dock": Goal(good=None),
            "service/reset_system": Goal(good=None),
        }

    async def prepare(self, name: str) -> None:
        if name == "action/dock":
            self.backend.device.sim.rover.x = 3.0  # the charger stands at the start

    def values(self, name: str) -> Sequence[Any]:
        if name == "param/speed_limit":
            return (0.5, 1.0)
        return ({"linear": {"x": 0.4}, "angular": {"z": 0.2}}, {"linear": {"x": 0.1}})

    @asynccontextmanager
    async def refusing(self, name: str) -> AsyncGenerator[None]:
        self.backend.device.strike(FaultSpec("refuse", target=name))
        yield
        self.backend.device.clear_faults()

    async def break_link(self) -> None:
        device = self.backend.device
        device.strike(FaultSpec("link_lost"))

        async def lost() -> bool:
            return device.faults.link_lost

        await eventually(lost, "the link is lost")

    async def mend_link(self) -> None:
        self.backend.device.clear_faults()

    async def freeze_device(self) -> None:
        device = self.backend.device
        device.strike(FaultSpec("slow", delay=60.0))
        device.strike(FaultSpec("sensor_stop"))

    async def thaw_device(self) -> None:
        self.backend.device.clear_faults()

    async def freeze_feedback(self) -> None:
        self.backend.device.strike(FaultSpec("sensor_stop"))

    async def thaw_feedback(self) -> None:
        self.backend.device.clear_faults()

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        async def command() -> None:
            while True:  # as fast as another's joystick
                with suppress(RcpError):
                    self.backend.device.sim.drive(0.5, 0.0)
                await asyncio.sleep(0.05)

        task = asyncio.create_task(command())
        try:
            yield
        finally:
            task.cancel()


class TestSim(SimRig, BackendSuite):
    """What any backend owes."""


class TestSimStops(Hurried, SimRig, StopSuite):
    """What any stop owes."""


class TestSimProfiles(Hurried, ProfileSuite):
    """What the profiles mean, as the simulation has it."""

    kind = SimRig.kind
    config: ClassVar[Mapping[str, Any]] = {
        "world": {
            "width": 12.0,
            "height": 12.0,
            "obstacles": [{"x": 0.0, "y": 4.5, "size_x": 8.0, "size_y": 1.0}],
        },
        "noise": 0.0,
        "map_resolution": 0.5,
        "time_scale": 3.0,
    }
    profiles = ("mobile", "battery", "camera", "lidar", "power")

    async def body(self) -> Body:
        rover = self.backend.device.sim.rover
        return Body(x=rover.x, y=rover.y, yaw=rover.yaw, forward=rover.v, yaw_rate=rover.w)

    async def at_rest(self) -> bool:
        return self.backend.device.sim.rover.at_rest

    async def charge(self) -> float:
        return self.backend.device.sim.pack.charge

    async def obstacle(self, bearing: float) -> float | None:
        """Measure to the box on its left and to the walls, at right angles from the start."""
        x, y = math.cos(bearing), math.sin(bearing)
        left = 4.0 if y > 0 else 6.0
        return min(6.0 / abs(x) if x else math.inf, left / abs(y) if y else math.inf)
