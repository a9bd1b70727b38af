"""The stop suite at a hub: the rover is simulated behind a gateway of its own and a real link."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any, ClassVar

import pytest

pytest.importorskip("zenoh")

import rcp_fleet
import rcp_sim
from backends.fleet.rig import appears, robot_at, serving
from ports import free_port
from rcp_gateway.testing import ADMIN, Goal, Robot, Served, StopSuite, eventually
from rcp_kernel.errors import RcpError
from rcp_sim.messages import FaultSpec
from transports.cable import Cable

_FLEET = next(iter(rcp_fleet.rcp_backends()))
_SIM = """
[[backends]]
use = "sim"
name = "rover"
tenant = "t"
world = "empty"
noise = 0.0
map_resolution = 0.5
time_scale = 5.0
"""
_ADMIN = f'[[keys]]\nname = "root"\nrole = "admin"\nkey = "{ADMIN}"\n'
_PLACE = "a robot of a fleet has its own place in the tree, which no other backend shares"


class _Far:
    """The robot's gateway, and the cable to it."""

    def __init__(self, port: int, cable: Cable, served: Served) -> None:
        self.port, self.cable, self.served = port, cable, served
        self.rover: Any = served.life.backend


@pytest.fixture(autouse=True)
def alone(request: pytest.FixtureRequest) -> None:
    """Leave out the situations with a second backend of the same robot."""
    if any(part in request.node.name for part in ("two_backends", "other_backend")):
        pytest.skip(_PLACE)


class TestFleetStops(StopSuite):
    """What any stop owes, through a hub."""

    kind = _FLEET
    stop_within: ClassVar[float] = 5.0
    distant = True

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[_Far]:
        port = free_port()
        async with Cable(port).laid() as cable:
            text = robot_at(cable.port, _SIM).replace('tenant = "alpha"', 'tenant = "t"')
            async with serving(text + _ADMIN, *rcp_sim.rcp_backends()) as served:
                yield _Far(port, cable, served)

    def table(self) -> Mapping[str, Any]:
        listen = [f"tcp/127.0.0.1:{self.device.port}"]
        return {"hub": "h1", "listen": listen, "token": ADMIN}

    @property
    def rover(self) -> Any:
        """The simulated rover itself, past hub, link and gateway."""
        return self.device.rover

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Robot]:
        async with super().served_by_device() as robot:
            await appears(robot.served.client(ADMIN), "/tenant/t/sensor/r7/pose")
            yield robot

    async def truth(self, name: str) -> Any:
        v, w = self.rover.device.sim.velocity
        return {"linear": {"x": v}, "angular": {"z": w}}

    async def at_rest(self) -> bool:
        return self.rover.device.sim.rover.at_rest

    def goals(self) -> Mapping[str, Goal]:
        here, far = {"position": {"x": 0.3, "y": 0.0}}, {"position": {"x": 15.0, "y": 0.0}}
        return {"action/r7/move_to": Goal(good=here, long=far)}

    def values(self, name: str) -> Sequence[Any]:
        return ({"linear": {"x": 0.4}, "angular": {"z": 0.2}}, {"linear": {"x": 0.1}})

    async def break_link(self) -> None:
        self.device.cable.part()

        async def lost() -> bool:
            return self.running.served.supervisor.unit("r7").state == "down"

        await eventually(lost, "the lost link is noticed")

    async def mend_link(self) -> None:
        self.device.cable.mend()

    async def freeze_device(self) -> None:
        self.device.cable.freeze()

    async def thaw_device(self) -> None:
        self.device.cable.mend()

    async def freeze_feedback(self) -> None:
        self.rover.device.strike(FaultSpec("sensor_stop"))

    async def thaw_feedback(self) -> None:
        self.rover.device.clear_faults()

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        async def command() -> None:
            while True:  # as fast as another's joystick
                with suppress(RcpError):
                    self.rover.device.sim.drive(0.5, 0.0)
                await asyncio.sleep(0.05)

        task = asyncio.create_task(command())
        try:
            yield
        finally:
            task.cancel()
