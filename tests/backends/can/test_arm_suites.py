"""Three CiA 402 drives are an arm, and stop as one whatever goes on and whatever goes wrong."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

import can

import rcp_can
from backends.can.rig import PATIENT, Node, channel
from rcp_can.sim import Bench, make_twin
from rcp_gateway.testing import Goal, ProfileSuite, StopRig, StopSuite, eventually
from rcp_gateway.testing.backend import Robot
from rcp_kernel.model import Resource

JOINTS = {"shoulder": 1, "elbow": 2, "wrist": 3}
"""Names and nodes."""
OPTIONS = {"control": "cyclic", "feedback": 10}


def points(*each: tuple[float, float]) -> dict[str, Any]:
    """Return a trajectory of all joints, by times and positions."""
    return {
        "points": [{"time": at, "positions": dict.fromkeys(JOINTS, where)} for at, where in each]
    }


class ArmRig(StopRig):
    kind = next(iter(rcp_can.rcp_backends()))
    cancel_within = 4.0

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Bench]:
        self.channel = channel()
        line = can.Bus(self.channel, "virtual", ignore_config=True)
        with Bench(line, [make_twin("cia402", n, **OPTIONS) for n in JOINTS.values()]) as bench:
            yield bench

    def table(self) -> Mapping[str, Any]:
        motor = {"bus": "can0", "profile": "cia402", "rate": 100, "position": [-6.0, 6.0]}
        motor |= {"velocity": 2.0, "acceleration": 20.0, "timeout": 1.0, "feedback_timeout": 1.0}
        motor |= {**PATIENT, "options": {**OPTIONS, **PATIENT["options"]}}
        bus = {"interface": "virtual", "channel": self.channel, "statistics": 0.1}
        return {
            "buses": {"can0": bus},
            "motors": {name: {**motor, "node": node} for name, node in JOINTS.items()},
            "joint_groups": {"arm": {"joints": list(JOINTS), "as_robot": True}},
            "grace": 5.0,
        }

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Robot]:
        async with super().served_by_device() as robot:

            async def enabled() -> bool:  # a drive whose process is held up may be late
                return (await robot.ask("execute", "service/enable"))["status"] == "completed"

            await eventually(enabled, "it is enabled, or nothing would be taken")
            yield robot

    def moving(self) -> list[Resource]:
        return sorted(super().moving(), key=lambda resource: resource.name != "actuator/joints")

    def values(self, name: str) -> Sequence[Any]:
        if name == "actuator/joints":
            return (dict.fromkeys(JOINTS, 5.0), {})
        return (0.4, 0.2) if name.startswith("actuator/") else super().values(name)

    async def prepare(self, name: str) -> None:
        await self.running.ask("execute", "service/enable")

    def goals(self) -> Mapping[str, Goal]:
        trajectory = Goal(good=points((1.0, 0.3)), long=points((1.5, 1.5), (5.0, 5.0)))
        return {"action/follow_trajectory": trajectory}

    async def at_rest(self) -> bool:
        return all(abs(twin.plant.velocity) < 0.1 for twin in self.device.twins)

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
        self.device.twins[0].silent = True  # one joint: its motor goes on by what it was told last

    async def thaw_device(self) -> None:
        self.device.twins[0].silent = False

    async def freeze_feedback(self) -> None:
        self.device.twins[1].blind = True

    async def thaw_feedback(self) -> None:
        self.device.twins[1].blind = False

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        """Enable one joint and command it a velocity from another node."""
        with Node(self.channel) as node:

            async def command() -> None:
                while True:
                    node.send(0x303, (2000).to_bytes(4, "little") + bytes(2))
                    for word in (0x06, 0x07, 0x0F):
                        node.send(0x203, bytes((word, 0, 3)) + bytes(4))
                        await asyncio.sleep(0.005)
                    await asyncio.sleep(0.1)

            task = asyncio.create_task(command())
            try:
                yield
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


class TestArmStops(ArmRig, StopSuite):
    pass


class TestArmProfiles(ArmRig, ProfileSuite):
    profiles = ("arm", "power")

    async def joints(self) -> Mapping[str, float]:
        twins = zip(JOINTS, self.device.twins, strict=True)
        return {name: twin.plant.position for name, twin in twins}

    async def powered(self) -> bool:
        states = {twin.enabled for twin in self.device.twins}
        assert len(states) == 1
        return states.pop()
