"""Two backends of one robot: they share its latch, and a stop that one cannot deliver the other does."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import pytest

from configuration import backend
from kernel.motion.test_latches import HEAD
from kernel.safety.scripted import ADMIN, DRIVE, FAST, HOLD, Scripted, estop, until_sent
from kernel.world import World, world_of
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import quantity

pytestmark = pytest.mark.anyio
TORSO = "/tenant/alpha/actuator/r1/torso"
TWO = HEAD + backend("base", robot="r1") + backend("torso", robot="r1") + backend("r2", robot="r2")


class Torso(Scripted):
    """The robot's other backend."""

    def declare(self) -> None:
        self.add(
            Resource(
                name="actuator/torso",
                description="Turns.",
                value=quantity("rad/s"),
                safe=0.0,
            )
        )

    async def write(self, name: str, value: Any) -> Any:
        self.sent.append(f"write {value:g}")


@pytest.fixture
async def parts() -> AsyncGenerator[tuple[World, Scripted, Scripted, Scripted]]:
    made: list[Scripted] = []

    def make(host: Host) -> Scripted:
        kind = Torso if getattr(host, "name", "") == "torso" else Scripted
        made.append(kind(host))
        return made[-1]

    async with world_of(TWO, make) as world:
        base, torso, other = (
            next(m for m in made if getattr(m.host, "name", "") == name)
            for name in ("base", "torso", "r2")
        )
        yield world, base, torso, other


Parts = tuple[World, Scripted, Scripted, Scripted]


async def test_a_stop_of_one_backend_stops_and_holds_the_whole_robot(parts: Parts) -> None:
    world, base, torso, other = parts
    admin = world.client(ADMIN)
    answer = await estop(admin, scope="torso")
    assert answer["status"] == "completed"
    assert set(answer["body"]["robots"]) == {"base", "torso"}
    assert (base.halts >= 1, torso.halts >= 1, other.halts) == (True, True, 0)
    for path, body in ((DRIVE, FAST), (TORSO, 1.0)):
        write = await admin.ask(type="write", path=path, body=body)
        assert write["error"]["code"] == "estop_active"
    reset = await estop(admin, scope="base", reset=True)
    assert reset["body"]["active"] is False
    assert (await admin.ask(type="write", path=TORSO, body=1.0))["status"] == "completed"


async def test_a_robot_is_not_confirmed_while_one_of_its_backends_is_not(parts: Parts) -> None:
    world, base, _, _ = parts
    base.lost = "the link is cut"
    answer = await estop(world.client(ADMIN), scope="torso", deadline=0.2)
    assert answer["error"]["code"] == "device_timeout"
    assert set(answer["error"]["details"]["robots"]) == {"base"}
    base.lost = ""  # a gateway that ends waits for its robots


async def test_a_lapsed_velocity_that_cannot_be_stopped_halts_the_other_backends(
    parts: Parts,
) -> None:
    world, base, torso, other = parts
    admin = world.client(ADMIN)
    await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=0.05)
    base.lost = "the link is cut"
    await until_sent(torso, "halt")
    assert other.halts == 0
    base.lost = ""
    await until_sent(base, "write 0")
    halts = torso.halts
    assert (await admin.ask(type="write", path=TORSO, body=1.0))["status"] == "completed"
    assert torso.halts == halts


async def test_a_hold_of_the_robot_holds_all_its_backends(parts: Parts) -> None:
    world, base, torso, other = parts
    held = await world.client(ADMIN).ask(type="execute", path=HOLD)
    assert held["status"] == "completed"
    assert (base.sent, torso.sent, other.sent) == (["hold"], ["hold"], [])


class Fleet(Scripted):
    """A hub's end of the robot's own gateway, and of that of another robot."""

    has_gateways = True

    def declare(self) -> None:
        self.add(
            *(
                Resource(
                    name=f"actuator/{robot}/drive",
                    robot=robot,
                    description="Drives.",
                    value=quantity("m/s"),
                    safe=0.0,
                    valid_for=0.5,
                )
                for robot in ("r1", "r2")
            )
        )


@pytest.fixture
async def hub() -> AsyncGenerator[tuple[World, Host]]:
    """A hub with a gateway's robot, of which another backend of the hub is a part."""
    made: list[Scripted] = []

    def make(host: Host) -> Scripted:
        kind = Torso if getattr(host, "name", "") == "torso" else Fleet
        made.append(kind(host))
        return made[-1]

    text = HEAD + backend("fleet") + backend("torso", robot="r1")
    async with world_of(text, make) as world:
        yield world, next(m.host for m in made if isinstance(m, Fleet))


async def test_a_reset_at_the_robots_gateway_frees_only_what_was_reset_there(
    hub: tuple[World, Host],
) -> None:
    world, host = hub
    admin = world.client(ADMIN)
    assert set((await estop(admin))["body"]["robots"]) == {"fleet/r1", "fleet/r2", "torso"}
    host.own_estop("r1", None, reset=True)
    state = (await admin.ask(type="read", path="/system/estop"))["body"]
    assert set(state["robots"]) == {"fleet/r2", "torso"}
    assert host.is_latched("r1") is False
    write = await admin.ask(type="write", path=TORSO, body=1.0)
    assert write["error"]["code"] == "estop_active"
    host.own_estop("r2", None, reset=True)
    assert (await estop(admin, reset=True))["body"]["active"] is False
    assert (await admin.ask(type="write", path=TORSO, body=1.0))["status"] == "completed"


async def test_a_reset_of_all_goes_on_showing_what_a_gateway_holds_that_is_not_discovered_yet(
    hub: tuple[World, Host],
) -> None:
    world, host = hub
    told = {"by": "someone", "reason": "at the robot", "since": "2026-01-01T00:00:00Z"}
    host.own_estop("r9", told)
    assert (await estop(world.client(ADMIN), reset=True))["status"] == "completed"
    assert host.is_latched("r9")
    host.own_estop("r9", None)
    assert not host.is_latched("r9")
