"""Who approves a plan to a named place approves where the place is: it is not moved afterwards."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import msgspec
import pytest

from configuration import key, role, rule
from plugins.places.test_places import CONFIG, MOVE, edit, served
from rcp_gateway.testing import MemoryClient, ScriptedRobot, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress

pytestmark = pytest.mark.anyio
ASKER, GUARD = "asker-asker-asker", "guard-guard-guard"
BOUND = 60.0  # s
EVERYTHING = (rule("*", "/**"), rule("*", "/system/**"))
TEXT = (
    CONFIG
    + role("asker", *EVERYTHING, approve=["/action/move_to"])
    + role("guard", *EVERYTHING, may_approve=True)
    + key("asker", ASKER, roles={"alpha": ["asker"]})
    + key("guard", GUARD, roles={"alpha": ["guard"]})
)
GOAL = {"position": {"place": "dock"}}
STEP = {"do": "execute", "path": MOVE, "value": GOAL}


async def dock(client: MemoryClient, x: float) -> None:
    done = await edit(client, name="dock", frame="map", position={"x": x, "y": 1})
    assert done["status"] == "completed", done


async def plan(client: MemoryClient, *steps: dict[str, Any], **more: Any) -> dict[str, Any]:
    return await client.request("execute", "/system/plans", body={"steps": [*steps]}, **more)


async def approved(asker: MemoryClient, guard: MemoryClient, reply: dict[str, Any]) -> str:
    id_ = reply["error"]["details"]["approval"]
    body = {"id": id_, "decision": "approve"}
    done = await guard.request("execute", "/system/approvals", body=body)
    assert done["status"] == "completed", done
    return id_


def robots(site: Served) -> list[ScriptedRobot]:
    return [one.backend for one in site.lives if isinstance(one.backend, ScriptedRobot)]


class Shelf(msgspec.Struct):
    """Where something lies: no place of a map."""

    place: str


class Parcel(msgspec.Struct):
    """A value of the robot's own that looks like a goal at a place."""

    position: Shelf


def carrier(host: Host) -> ScriptedRobot:
    """A robot with resources that have places of their own."""
    fetch = Resource(name="action/fetch", description="Fetches.", input=Parcel)
    parcel = Resource(name="param/parcel", description="What it carries.", value=Parcel)
    robot = ScriptedRobot(host, fetch, parcel)
    robot.behaviours["action/fetch"] = partial(arrive, robot)
    robot.release.set()
    return robot


@asynccontextmanager
async def gateway() -> AsyncGenerator[Served]:
    async with served(TEXT) as site:
        for robot in robots(site):
            robot.behaviours["action/move_to"] = partial(arrive, robot)
        yield site


async def arrive(robot: ScriptedRobot, _value: Any, progress: Progress) -> None:
    await robot.wait(None, progress)


def release(site: Served) -> None:
    """Let the robots arrive."""
    for robot in robots(site):
        robot.release.set()


async def begun(site: Served) -> None:
    """Wait until one of the robots goes."""
    waiting = [asyncio.ensure_future(robot.started.get()) for robot in robots(site)]
    async with asyncio.timeout(BOUND):
        await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
    for one in waiting:
        one.cancel()


async def test_the_approval_of_a_plan_shows_and_is_for_where_its_places_are() -> None:
    async with gateway() as site:
        asker, guard = site.client(ASKER), site.client(GUARD)
        await dock(asker, 2)
        id_ = await approved(asker, guard, await plan(asker, STEP))
        (shown,) = (await guard.request("read", "/system/approvals"))["body"]
        place = shown["value"]["steps"][0]["place"]
        assert (place["frame"], place["position"]["x"]) == ("map", 2)
        await dock(asker, 20)
        moved = await plan(asker, STEP, approval=id_)
        assert moved["error"]["code"] == "forbidden"
        await dock(asker, 2)
        release(site)
        assert (await plan(asker, STEP, approval=id_))["status"] == "completed"


async def test_a_place_that_is_moved_while_its_plan_runs_is_not_gone_to() -> None:
    async with gateway() as site:
        asker, guard = site.client(ASKER), site.client(GUARD)
        await dock(asker, 2)
        steps = ({**STEP, "value": {"position": {"x": 0.5, "y": 0.5}}}, STEP)
        id_ = await approved(asker, guard, await plan(asker, *steps))
        body = {"steps": [*steps]}
        sent = await asker.send(type="execute", path="/system/plans", body=body, approval=id_)
        await begun(site)
        await dock(asker, 20)
        release(site)
        ended = await asker.final(sent)
        assert ended["error"]["code"] == "precondition_failed"
        assert "'dock'" in ended["message"]


@pytest.mark.parametrize(("do", "name"), [("execute", "action/fetch"), ("write", "param/parcel")])
async def test_a_place_of_a_robots_own_is_none_of_the_gateway(do: str, name: str) -> None:
    text = TEXT.replace("/action/move_to", f"/{name}")
    async with serve(text, scripted(carrier, "rover")) as site:
        asker, guard = site.client(ASKER), site.client(GUARD)
        value = {"position": {"place": "B7"}}
        step = {"do": do, "path": f"/tenant/alpha/{name}", "value": value}
        id_ = await approved(asker, guard, await plan(asker, step))
        done = await plan(asker, step, approval=id_)
        assert done["status"] == "completed", done
