"""The CAN backend keeps what the house asks of a backend, whatever drive is on the bus."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import can

import rcp_can
from backends.can.rig import MOTORS, OTHERS, Node, channel
from rcp_can.dronecan.library import make
from rcp_can.dronecan.transfers import encode
from rcp_can.sim import Bench, Twin, make_twin
from rcp_gateway.testing import BackendSuite, Goal, StopRig, StopSuite, eventually
from rcp_gateway.testing.backend import Robot

_ALIKE = 8  # set-points in a row, at the end of a ramp
_MARK = 0x7F0  # an identifier that no drive has


class Mark(Twin):
    """Tells when the bench has taken all frames from before a frame of its own."""

    def __init__(self) -> None:
        super().__init__(0)
        self.seen = 0

    def take(self, message: can.Message) -> None:
        """Count its own frame."""
        self.seen += message.arbitration_id == _MARK


class CanRig(StopRig):
    kind = next(iter(rcp_can.rcp_backends()))
    profile: ClassVar[str]
    complete_within = 20.0
    cancel_within = 4.0

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Bench]:
        self.channel, table = channel(), (MOTORS | OTHERS)[self.profile]
        protocol = can.CanProtocol.CAN_FD if self.profile == "moteus" else can.CanProtocol.CAN_20
        line = can.Bus(self.channel, "virtual", protocol=protocol, ignore_config=True)
        twin = make_twin(self.profile, table["node"], **table.get("options", {}))
        with Bench(line, [twin, Mark()]) as bench:
            yield bench

    def table(self) -> Mapping[str, Any]:
        bus = {"interface": "virtual", "channel": self.channel, "statistics": 0.1}
        bus["fd"] = self.profile == "moteus"
        motor = {
            "bus": "can0",
            "profile": self.profile,
            "velocity": 4.0,
            **(MOTORS | OTHERS)[self.profile],
        }
        return {
            "buses": {"can0": bus},
            "motors": {"m": {**motor, "timeout": 1.0, "feedback_timeout": 1.0, "valid_for": 5.0}},
        }

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Robot]:
        async with super().served_by_device() as robot:

            async def enabled() -> bool:  # a drive whose process is held up may be late
                return (await robot.ask("execute", "service/m/enable"))["status"] == "completed"

            await eventually(enabled, "it is enabled, or nothing would be taken")
            yield robot

    async def prepare(self, name: str) -> None:
        await self.running.ask("execute", "service/m/enable")

    async def truth(self, name: str) -> Any:
        """Return the set-point that the drive takes from now on, once it stays the same."""
        await self._older_are_taken()
        twin, mode = self.device.twins[0], name.rpartition("/")[2]
        twin.commands.clear()
        taken: list[float] = []

        async def stays() -> bool:
            taken[:] = [round(value, 1) + 0.0 for kind, value in twin.commands if kind == mode]
            return len(taken) > _ALIKE and len(set(taken[-_ALIKE:])) == 1

        await eventually(stays, "a set-point stays the same")
        return taken[-1]

    async def _older_are_taken(self) -> None:
        """Wait until the drive has taken all set-points that have been sent, however late it is."""
        mark, bus = self.device.twins[1], self.backend.buses["can0"]
        assert isinstance(mark, Mark)
        seen = mark.seen

        async def sent() -> bool:
            return bus.lag == 0.0

        async def taken() -> bool:
            return mark.seen > seen

        await eventually(sent, "nothing waits to be sent")
        with Node(self.channel, fd=self.profile == "moteus") as node:
            node.send(_MARK)
        await eventually(taken, "the bench has taken what is on the bus")

    def values(self, name: str) -> Sequence[Any]:
        return (0.4, 0.2) if name.startswith("actuator/") else super().values(name)

    async def confirms(self, name: str, result: Any) -> bool:
        return abs(self.device.twins[0].plant.position - result["position"]) < 0.05

    async def at_rest(self) -> bool:
        return abs(self.device.twins[0].plant.velocity) < 0.1

    def goals(self) -> Mapping[str, Goal]:
        found: dict[str, Goal] = {}
        if self.profile not in ("vesc", "dronecan"):
            goal = Goal(good={"position": 0.5}, long={"position": 7.0})
            found["action/m/move_to"] = goal
        if self.profile in ("cia402", "odrive"):
            found["action/m/home"] = Goal(good=None)
        return found

    async def break_link(self) -> None:
        self.device.twins[0].silent = True

        async def lost() -> bool:
            return not self.backend.axes["m"].online

        await eventually(lost, "it is missed")

    async def mend_link(self) -> None:
        self.device.twins[0].silent = False

    async def freeze_device(self) -> None:
        self.device.twins[0].silent = True  # its motor goes on by what it was told last

    async def thaw_device(self) -> None:
        self.device.twins[0].silent = False

    async def freeze_feedback(self) -> None:
        self.device.twins[0].blind = True

    async def thaw_feedback(self) -> None:
        self.device.twins[0].blind = False

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        """Enable it and command a velocity from another node, ten times a second."""
        with Node(self.channel) as node:

            async def command() -> None:
                while True:
                    for frame, data in FOREIGN[self.profile]:
                        node.send(frame, data)
                        await asyncio.sleep(0.005)
                    await asyncio.sleep(0.1)

            task = asyncio.create_task(command())
            try:
                yield
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


FOREIGN = {
    "dronecan": encode(
        make("equipment.esc.RPMCommand", rpm=[0, 40]), source=50, transfer_id=0, priority=8
    ),
    "odrive": [(1 << 5 | 0x0D, struct.pack("<ff", 0.5, 0.0))],
    "cia402": [
        (0x305, struct.pack("<ih", 2000, 0)),
        *((0x205, bytes((word, 0, 3)) + bytes(4)) for word in (0x06, 0x07, 0x0F)),
    ],
}
"""What another master sends so that the drive of a profile turns."""


class TestOdrive(CanRig, BackendSuite):
    profile = "odrive"


class TestCia402(CanRig, BackendSuite):
    profile = "cia402"


class TestOdriveStops(CanRig, StopSuite):
    profile = "odrive"


class TestCia402Stops(CanRig, StopSuite):
    profile = "cia402"


class TestDronecan(CanRig, BackendSuite):
    profile = "dronecan"


class TestDronecanStops(CanRig, StopSuite):
    profile = "dronecan"
