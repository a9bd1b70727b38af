"""Two CiA 402 drives are a mobile robot, and stop as one whatever goes on and whatever goes wrong."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

import can

import rcp_can
from backends.can.rig import Node, channel
from backends.can.rover import RIGHT, rover_bench, tables, twins
from rcp_can.sim import Bench
from rcp_gateway.testing import Body, Goal, ProfileSuite, StopRig, StopSuite, eventually
from rcp_gateway.testing.backend import Robot
from rcp_kernel.model import Resource


class RoverRig(StopRig):
    kind = next(iter(rcp_can.rcp_backends()))
    cancel_within = 4.0

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Bench]:
        self.channel = channel()
        line = can.Bus(self.channel, "virtual", ignore_config=True)
        with rover_bench(line) as bench:
            yield bench

    def table(self) -> Mapping[str, Any]:
        return tables(self.channel)

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Robot]:
        async with super().served_by_device() as robot:

            async def enabled() -> bool:  # a drive whose process is held up may be late
                return (await robot.ask("execute", "service/enable"))["status"] == "completed"

            await eventually(enabled, "it is enabled, or nothing would be taken")
            yield robot

    def moving(self) -> list[Resource]:
        return sorted(super().moving(), key=lambda resource: resource.name != "actuator/cmd_vel")

    def values(self, name: str) -> Sequence[Any]:
        return (0.4, 0.2) if name.startswith("actuator/left") else super().values(name)

    async def prepare(self, name: str) -> None:
        await self.running.ask("execute", "service/enable")

    def goals(self) -> Mapping[str, Goal]:
        near, far = ({"position": {"x": x, "y": 0.0}, "frame": "odom"} for x in (0.2, 5.0))
        return {"action/move_to": Goal(good=near, long=far)}

    async def at_rest(self) -> bool:
        return twins(self.device)[2].still()

    async def break_link(self) -> None:
        for twin in self.device.twins:
            twin.silent = True

        async def lost() -> bool:
            return not any(axis.online for axis in self.backend.axes.values())

        await eventually(lost, "they are missed")

    async def mend_link(self) -> None:
        for twin in self.device.twins:
            twin.silent = False

    async def freeze_device(self) -> None:
        self.device.twins[0].silent = True  # one wheel: its motor goes on by what it was told last

    async def thaw_device(self) -> None:
        self.device.twins[0].silent = False

    async def freeze_feedback(self) -> None:
        self.device.twins[1].blind = True

    async def thaw_feedback(self) -> None:
        self.device.twins[1].blind = False

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        """Enable one wheel and command it a velocity from another node."""
        with Node(self.channel) as node:

            async def command() -> None:
                while True:
                    node.send(0x300 + RIGHT, struct.pack("<ih", 2000, 0))
                    for word in (0x06, 0x07, 0x0F):
                        node.send(0x200 + RIGHT, bytes((word, 0, 3)) + bytes(4))
                        await asyncio.sleep(0.005)
                    await asyncio.sleep(0.1)

            task = asyncio.create_task(command())
            try:
                yield
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


class TestRoverStops(RoverRig, StopSuite):
    pass


class TestRoverProfiles(RoverRig, ProfileSuite):
    profiles = ("mobile", "power")

    async def body(self) -> Body:
        truth = twins(self.device)[2]
        forward, turn = truth.moving
        return Body(x=truth.x, y=truth.y, yaw=truth.heading, forward=forward, yaw_rate=turn)

    async def powered(self) -> bool:
        left, right, _ = twins(self.device)
        assert left.enabled == right.enabled
        return left.enabled
