"""A hub shows of a robot what the robot's own gateway shows, also when it changes."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Annotated, Any

import pytest
from msgspec import Meta

pytest.importorskip("zenoh")

from backends.fleet.rig import SIM, appears, catalogue, hub_at, robot_at, serving
from configuration import backend
from ports import free_port
from rcp_gateway.testing import OPERATOR, Client, ScriptedRobot, eventually, scripted
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host

BUS = {"interface": "virtual", "channel": "fleet-discovery", "bitrate": 1_000_000, "simulate": True}
PAN = {
    "bus": "can0",
    "profile": "odrive",
    "node": 1,
    "gear": 8.0,
    "position": [-2.8, 2.8],
    "velocity": 3.0,
    "torque": 4.0,
    "acceleration": 12.0,
}
MOTORS = backend("head", use="can", buses={"can0": BUS}, motors={"pan": PAN})
COPTER = backend("drone", use="mavlink", links=["sim:copter"], twin={"warmup": 2})
ROBOTS = pytest.mark.parametrize("robot", [SIM, MOTORS, COPTER], ids=["sim", "can", "mavlink"])
LOCAL = ("path", "backend", "state", "meta")
"""What is true at one place only: where it is, who serves it there, and what has been seen of it."""
NOT_PASSED = ("frames", "native", "command_schema")
"""What a gateway tells of itself: the frames and places that it converts goals from."""
_LINK = "/tenant/alpha/sensor/r7/link"


@asynccontextmanager
async def both(text: str) -> AsyncGenerator[tuple[Client, Client]]:
    """Yield clients of a robot's gateway and of the hub, once the hub shows all of it."""
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port, text)) as robot:
        there, here = robot.client(OPERATOR), hub.client(OPERATOR)

        async def all_there() -> bool:
            own, shown = await catalogue(there), of_robots(await catalogue(here))
            return bool(own) and robot.supervisor.state == "ready" and len(own) == len(shown)

        await eventually(all_there, "the hub shows as much as the robot", 60.0)
        yield there, here
        await there.close()
        await here.close()


def of_robots(shown: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Leave out what the hub itself has of a robot."""
    return {path: facts for path, facts in shown.items() if path != _LINK}


def hub_path(path: str) -> str:
    """Return the hub's path of a robot's."""
    _, tenant, name, branch, rest = path.split("/", 4)
    return f"/{tenant}/{name}/{branch}/r7/{rest}"


def common(facts: dict[str, Any]) -> dict[str, Any]:
    """Leave out what need not be equal."""
    return {key: fact for key, fact in facts.items() if key not in (*LOCAL, *NOT_PASSED)}


@ROBOTS
async def test_a_hub_shows_what_the_robot_shows(robot: str) -> None:
    async with both(robot) as (there, here):
        own, shown = await catalogue(there), of_robots(await catalogue(here))
        assert shown.keys() == {hub_path(path) for path in own}
        for path, facts in own.items():
            assert common(shown[hub_path(path)]) == common(facts), path
            extra = facts.get("meta", {})
            assert extra.items() <= shown[hub_path(path)]["meta"].items(), path


async def the_robot(client: Client) -> dict[str, Any]:
    """Return what the inventory says of what a robot is."""
    (robot,) = (await client.request("read", "/system/robots"))["body"]
    names = ("kind", "profiles", "vendor", "model", "firmware", "serial", "fact_sheet")
    facts = {name: robot.get(name) for name in names}
    limits = facts["fact_sheet"].get("limits", {})
    facts["fact_sheet"]["limits"] = {name.replace("/r7/", "/"): at for name, at in limits.items()}
    return facts


@ROBOTS
async def test_its_inventory_says_what_the_robots_says(robot: str) -> None:
    async with both(robot) as (there, here):

        async def told() -> bool:
            return await the_robot(here) == await the_robot(there)

        await eventually(told, "the facts have arrived", 30.0)


Wide = Annotated[float, Meta(ge=0, le=10, extra_json_schema={"unit": "m"})]
Narrow = Annotated[float, Meta(ge=0, le=5, extra_json_schema={"unit": "m"})]


class Lifts:
    """A robot whose resources change while it runs, and the hub's view of it."""

    def __init__(self) -> None:
        self.robot: ScriptedRobot

    def make(self, host: Host) -> ScriptedRobot:
        """Make the robot."""
        self.robot = ScriptedRobot(
            host,
            Resource(name="param/height", description="Height.", value=Wide),
            Resource(name="sensor/load", description="Load.", value=Wide),
        )
        return self.robot


async def test_a_change_of_the_robot_shows_at_the_hub() -> None:
    port, lifts = free_port(), Lifts()
    own = backend("robot")
    async with (
        serving(hub_at(port)) as hub,
        serving(robot_at(port, own), scripted(lifts.make)),
    ):
        here = hub.client(OPERATOR)
        await appears(here, "/tenant/alpha/param/r7/height")
        lifts.robot.add(Resource(name="action/lift", description="Lift.", input=Wide))
        await appears(here, "/tenant/alpha/action/r7/lift")
        lifts.robot.add(Resource(name="param/height", description="Height.", value=Narrow))

        async def narrower() -> bool:
            found = await appears(here, "/tenant/alpha/param/r7/height")
            return found["schemas"]["value"].get("maximum") == 5

        await eventually(narrower, "the new type is shown")
        lifts.robot.remove("sensor/load")

        async def gone() -> bool:
            return "/tenant/alpha/sensor/r7/load" not in await catalogue(here)

        await eventually(gone, "what was removed is not shown")
        await here.close()
