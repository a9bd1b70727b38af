"""One backend with several robots: each is stopped, held and freed alone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from configuration import backend
from kernel.motion.test_latches import ADMIN, CHIEF, GUEST, HEAD, estop, moves
from kernel.world import BOUND, Robot, World, kept_in, settled, world_of
from rcp_kernel.errors import DeviceTimeout, InvalidPath
from rcp_kernel.model import Resource
from rcp_kernel.types import Twist, quantity

pytestmark = pytest.mark.anyio
YARD = HEAD + backend("yard")
FAST = {"linear": {"x": 1.0}}


class Yard(Robot):
    """Two robots behind one backend, and what belongs to neither."""

    def declare(self) -> None:
        self.halted: list[str] = []
        self.alone = asyncio.Event()
        self.add(Resource(name="sensor/weather", description="It.", value=quantity("K")))
        for name in ("r1", "r2"):
            self.appear(name)

    def appear(self, name: str) -> None:
        """Put one of the robots into the tree."""
        self.add(
            Resource(
                name=f"sensor/{name}/level", robot=name, description="It.", value=quantity("m")
            ),
            Resource(
                name=f"actuator/{name}/drive",
                robot=name,
                description="Drives.",
                value=Twist,
                safe=Twist(),
            ),
            Resource(
                name=f"action/{name}/go",
                robot=name,
                description="Goes.",
                input=quantity("1"),
                feedback=quantity("1"),
            ),
        )

    async def halt_robot(self, robot: str) -> None:
        self.halted.append(robot)
        self.alone.set()


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    async with world_of(YARD, Yard) as made:
        yield made


def yard(world: World) -> Yard:
    robot = world.robots[-1]
    assert isinstance(robot, Yard)
    return robot


@pytest.mark.parametrize("scope", ["yard/r1", "/tenant/alpha/r1", "/actuator/r1/drive"])
async def test_a_stop_of_one_robot_halts_and_holds_that_robot_alone(
    world: World, scope: str
) -> None:
    admin = world.client(CHIEF)
    going = [
        admin.send(type="execute", path=f"/tenant/alpha/action/{name}/go", body=1)
        for name in ("r1", "r2")
    ]
    async with asyncio.timeout(BOUND):
        for _ in going:
            await world.robot.started.get()
    state = (await estop(admin, scope=scope))["body"]
    assert set(state["robots"]) == {"yard/r1"}
    assert (set(yard(world).halted), yard(world).halts) == ({"r1"}, 0)
    assert (await admin.final(going[0]))["status"] == "cancelled"
    assert not await moves(admin, "r1")
    assert await moves(admin, "r2")
    world.robot.release.set()
    assert (await admin.final(going[1]))["status"] == "completed"
    assert (await estop(admin, scope=scope, reset=True))["body"]["active"] is False
    assert await moves(admin, "r1")


async def test_a_stop_of_all_is_one_halt_and_one_robot_may_be_freed_from_it(world: World) -> None:
    admin = world.client(ADMIN)
    for scope in ("yard", "/tenant/alpha", None):
        yard(world).halts = 0
        body = {} if scope is None else {"scope": scope}
        assert set((await estop(admin, **body))["body"]["robots"]) == {"yard/r1", "yard/r2"}
        assert (yard(world).halted, yard(world).halts) == ([], 1)
        assert set(
            (await estop(admin, scope="/tenant/alpha/r1", reset=True))["body"]["robots"]
        ) == {"yard/r2"}
        assert await moves(admin, "r1")
        assert not await moves(admin, "r2")
        state = (await estop(admin, reset=True))["body"]
        assert state.pop("reset") is not None
        assert state == {
            "active": False,
            "robots": {},
            "scopes": {},
            "groups": [],
        }
        assert await moves(admin, "r2")


class Hub(Yard):
    """The same with gateways of their own, of which one does not answer and one fails at first."""

    has_gateways = True

    def declare(self) -> None:
        super().declare()
        self.appear("r3")
        self.asked, self.rests = asyncio.Event(), asyncio.Event()

    async def halt(self) -> None:
        self.halted.append("all")

    async def halt_robot(self, robot: str) -> None:
        await super().halt_robot(robot)
        if robot == "r3" and self.halted.count("r3") == 1:
            raise DeviceTimeout("no answer")
        if robot == "r1":
            if self.halted.count("r1") > 1:
                self.asked.set()
            await self.rests.wait()


@pytest.mark.parametrize(("scope", "reached"), [("yard", 1), (None, 1), ("yard/r2", 0)])
async def test_a_stop_of_all_reaches_gateways_that_have_shown_nothing_yet(
    scope: str | None, reached: int
) -> None:
    async with world_of(YARD, Hub) as world:
        hub, admin = yard(world), world.client(ADMIN)
        assert isinstance(hub, Hub)
        hub.rests.set()
        body = {} if scope is None else {"scope": scope}
        assert (await admin.ask(type="execute", path="/system/estop", body=body))["body"]["active"]
        assert hub.halted.count("all") == reached


async def test_no_gateway_waits_for_another_and_only_the_one_that_is_late_is_asked_again() -> None:
    async with world_of(YARD, Hub) as world:
        hub, admin = yard(world), world.client(ADMIN)
        assert isinstance(hub, Hub)
        stop = admin.send(type="execute", path="/system/estop", body={"scope": "yard"})
        async with asyncio.timeout(BOUND):
            await hub.asked.wait()
        told = (await admin.ask(type="read", path="/system/estop"))["body"]["robots"]
        assert {name: one["state"] for name, one in told.items()} == {
            "yard/r1": "commanded",
            "yard/r2": "confirmed",
            "yard/r3": "confirmed",
        }
        hub.rests.set()
        assert (await admin.final(stop))["status"] == "completed"
        assert (hub.halted.count("r2"), hub.halted.count("r3")) == (1, 2)


async def test_who_sees_one_robot_stops_that_one(world: World) -> None:
    guest, admin = world.client(GUEST), world.client(ADMIN)
    for scope in (None, "yard", "/tenant/alpha"):
        body = {} if scope is None else {"scope": scope}
        assert set((await estop(guest, **body))["body"]["robots"]) == {"yard/r1"}
        assert await moves(admin, "r2")
        await estop(admin, scope="yard/r1", reset=True)
    for hidden in ("yard/r2", "/tenant/alpha/r2"):
        assert (await estop(guest, scope=hidden))["error"]["code"] == "unknown_path"


async def test_a_robot_that_appears_while_its_backend_is_stopped_is_halted(world: World) -> None:
    admin = world.client(ADMIN)
    await estop(admin, scope="yard")
    yard(world).appear("r3")
    async with asyncio.timeout(BOUND):
        await yard(world).alone.wait()
    assert yard(world).halted == ["r3"]
    assert not await moves(admin, "r3")


async def test_what_was_sent_before_a_stop_of_one_robot_reaches_the_others_only(
    world: World,
) -> None:
    admin = world.client(ADMIN)
    writes = [
        admin.send(type="write", path=f"/tenant/alpha/actuator/{name}/drive", body=FAST)
        for name in ("r1", "r2")
    ]
    await estop(admin, scope="yard/r1")
    await estop(admin, scope="yard/r1", reset=True)
    assert (await admin.final(writes[0]))["error"]["code"] == "estop_active"
    assert (await admin.final(writes[1]))["status"] == "completed"
    assert [name for name, _ in world.robot.writes] == ["actuator/r2/drive"]


async def test_the_latch_of_one_robot_outlives_the_gateway(tmp_path: Path) -> None:
    text = kept_in(tmp_path / "rcp.db", YARD)
    async with world_of(text, Yard) as world:
        await estop(world.client(ADMIN), scope="yard/r2", reason="smoke")
        await settled(world.server.gateway.store)
    async with world_of(text, Yard) as world:
        admin = world.client(ADMIN)
        state: dict[str, Any] = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert {name: at["reason"] for name, at in state["robots"].items()} == {"yard/r2": "smoke"}
        assert yard(world).halted == ["r2"]
        assert not await moves(admin, "r2")
        assert await moves(admin, "r1")


def test_a_resource_lies_where_its_robot_is() -> None:
    with pytest.raises(InvalidPath, match="not a resource of robot 'r1'"):
        Resource(name="sensor/level", robot="r1", description="It.")
