"""A robot whose every reaction to a stop a test decides."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from configuration import backend
from kernel.motion.test_latches import HEAD
from kernel.world import BOUND, Client, Robot, World, kept_in, world_of
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, MotionState, Progress, Watchdog, check_fence
from rcp_kernel.types import quantity

ESTOP = "/system/estop"
ONE = HEAD + backend("r1", robot="r1")
ADMIN = "admin-admin-admin"
DRIVE, GO = "/tenant/alpha/actuator/r1/drive", "/tenant/alpha/action/r1/go"
HOLD = "/tenant/alpha/service/r1/hold"
FAST = {"linear": {"x": 1.0}}


class Scripted(Robot):
    """Says of its motion what the test says, and notes what it is sent, in order."""

    def __init__(self, host: Host) -> None:
        super().__init__(host)
        self.state: MotionState | None = MotionState(at_rest=True)
        self.sent: list[str] = []
        self.recovered = asyncio.Event()
        self.asserted = asyncio.Event()
        self.holding = asyncio.Event()
        self.rests = asyncio.Event()
        """Whether a hold has brought it to rest."""
        self.rests.set()
        self.on_loss = "land"

    def declare(self) -> None:
        super().declare()
        self.add(
            Resource(
                name="service/enable",
                description="Gives torque.",
                energises=True,
                output=quantity("1"),
            ),
            Resource(name="service/dock", description="Docks.", moves=True),
        )

    async def write(self, name: str, value: Any) -> Any:
        await self.reach()
        check_fence()
        self.sent.append(f"write {value.linear.x:g}" if "drive" in name else f"write {name}")
        self.asserted.set()
        return await super().write(name, value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        await self.reach()
        self.sent.append(f"execute {name}")
        try:
            return await super().execute(name, value, progress)
        except asyncio.CancelledError:
            check_fence()
            self.sent.append("its own hold")
            raise

    async def halt(self) -> None:
        self.halts += 1
        await self.reach()
        self.sent.append("halt")
        self.asserted.set()

    async def hold(self, robot: str | None) -> None:
        await self.reach()
        self.sent.append("hold")
        self.holding.set()
        await self.rests.wait()
        self.asserted.set()

    def motion(self, robot: str | None) -> MotionState | None:
        return MotionState(None, self.lost) if self.lost else self.state

    def hold_stop(self, robot: str | None) -> None:
        self.asserted.set()
        if not self.lost:
            self.sent.append("hold_stop")

    async def recover(self, robot: str | None) -> str:
        await self.reach()
        self.sent.append("recover")
        self.recovered.set()
        return "landed"

    def watchdogs(self) -> tuple[Watchdog, ...]:
        return ()


def scripted(world: World) -> Scripted:
    """Return the robot's present life."""
    robot = world.robot
    assert isinstance(robot, Scripted)
    return robot


@asynccontextmanager
async def scripted_world(
    text: str = ONE,
    store: Path | None = None,
    make: type[Scripted] = Scripted,
    clock: Clock = SYSTEM_CLOCK,
) -> AsyncGenerator[World]:
    """Run a gateway around scripted robots."""
    async with world_of(text if store is None else kept_in(store, text), make, clock) as world:
        yield world


async def estop(client: Client, *, deadline: float | None = None, **body: Any) -> dict[str, Any]:
    """Stop or reset, and return the answer."""
    fields = {} if deadline is None else {"deadline": deadline}
    return await client.ask(type="execute", path=ESTOP, body=body, **fields)


async def state_of(client: Client, robot: str = "r1") -> dict[str, Any]:
    """Return what `/system/estop` says of a robot."""
    return (await client.ask(type="read", path=ESTOP))["body"]["robots"][robot]


async def shows(client: Client, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Wait until `/system/estop` says something of r1."""
    id_ = client.send(type="subscribe", path=ESTOP, body={})
    async with asyncio.timeout(BOUND):
        while True:
            update = await client.update(id_)
            robot = update["body"]["robots"].get("r1")
            if robot is not None and holds(robot):
                client.send(type="unsubscribe", body={"subscription": id_})
                return robot


async def until_sent(robot: Scripted, what: str, times: int = 1) -> None:
    """Wait until the robot was sent something so many times; looked at with what it is sent."""
    async with asyncio.timeout(BOUND):
        while robot.sent.count(what) < times:
            robot.asserted.clear()
            await robot.asserted.wait()
