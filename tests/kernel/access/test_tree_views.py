"""What somebody sees of a large tree is found out in steps, and only what changed is looked at again."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from configuration import key, role, rule
from kernel.judging import AT_ONCE, judged
from kernel.world import BOUND, CONFIG, Client, Robot, World, world_of
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.tree_views import TreeView
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
PATHS = 10_000
NARROW = role("narrow", rule("read discover", "/sensor/**", "/system/status")) + key(
    "narrow", "narrow-narrow-narrow"
)


class Many(Robot):
    """A robot with many sensors and parameters."""

    def declare(self) -> None:
        """Put them into the tree."""
        for number in range(PATHS):
            self.add(level(number))

    def change(self, number: int) -> None:
        self.add(level(number, "Another level."))


def level(number: int, description: str = "A level.") -> Resource:
    branch = ("sensor", "param")[number % 2]
    return Resource(name=f"{branch}/level-{number:05}", description=description, value=int)


@asynccontextmanager
async def many() -> AsyncGenerator[World]:
    async with world_of(CONFIG + NARROW, Many) as world:
        yield world


def narrow(world: World) -> Client:
    return world.client("narrow-narrow-narrow")


def rights_of(world: World) -> Rights:
    api = world.server.client_api
    return api.rights(api.authenticate("narrow-narrow-narrow"))


@pytest.mark.parametrize(
    "request_",
    [
        {"type": "discover", "path": "/**", "body": {"q": "nothing", "limit": 1000}},
        {"type": "status"},
        {"type": "read", "path": "/system/status"},
    ],
    ids=["discover", "status", "read of the status"],
)
async def test_the_first_request_under_new_rights_judges_few_resources_in_a_turn(
    monkeypatch: pytest.MonkeyPatch, request_: dict[str, Any]
) -> None:
    async with many() as world:
        client = narrow(world)
        with judged(monkeypatch) as turns:
            reply = await client.ask(**request_)
        assert reply["status"] == "completed"
        assert sum(turns) > PATHS // 2
        assert max(turns) <= AT_ONCE


async def test_the_generation_is_known_at_once_and_judges_nothing_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with many() as world:
        api, session = world.server.client_api, narrow(world).connection.session
        with judged(monkeypatch) as turns:
            api.generation(session)
            assert turns[-1] <= AT_ONCE
            await _looked(world, session.rights)
            began, before = api.generation(session), sum(turns)
            world.robot.change(0)  # pyright: ignore[reportAttributeAccessIssue] - it is `Many`
            assert api.generation(session) > began
            assert sum(turns) - before <= 1


async def test_the_generation_rises_for_what_is_seen_and_not_for_what_is_hidden() -> None:
    async with many() as world:
        api, session, robot = world.server.client_api, narrow(world).connection.session, world.robot
        assert isinstance(robot, Many)
        await _looked(world, rights_of(world))
        began = api.generation(session)
        robot.change(1)
        robot.remove("param/level-00003")
        assert api.generation(session) == began
        robot.remove("sensor/level-00004")
        risen = api.generation(session)
        assert risen > began
        for number in range(1, PATHS, 2):  # more hidden ones than are looked at in one step
            robot.add(level(number, "Yet another level."))
        robot.change(0)
        async with asyncio.timeout(BOUND):
            while api.generation(session) == risen:  # noqa: ASYNC110 - it has no event
                await asyncio.sleep(0)


async def test_what_is_counted_is_what_there_is_however_the_tree_has_changed() -> None:
    async with many() as world:
        rights, robot, dice = rights_of(world), world.robot, random.Random(5)
        for _ in range(6):
            for _ in range(3000):  # more changes than are kept
                number = dice.randrange(PATHS)
                if dice.random() < 0.5:
                    robot.remove(level(number).name)
                else:
                    robot.add(level(number, f"Level {dice.randrange(3)}."))
            view = await _looked(world, rights)
            there = world.server.gateway.registry.entries.values()
            assert view.visible == sum(1 for e in there if rights.mask(e.path))
            hidden = [e for e in there if e.tenant and not rights.mask(e.path)]
            assert view.hidden_of("alpha", "robot").count == len(hidden)
            assert not view.whole("alpha")


async def test_somebody_from_whom_nothing_is_hidden_sees_the_whole() -> None:
    async with many() as world:
        api = world.server.client_api
        rights = api.rights(api.authenticate("admin-admin-admin"))
        views = world.server.gateway.status.tree_views
        assert not views.look(rights).whole(None)  # it is not known yet, and so denied
        await _looked(world, rights)
        assert views.look(rights).whole(None)
        assert views.look(rights).whole("alpha")


async def test_what_is_new_counts_as_hidden_until_it_was_looked_at() -> None:
    async with many() as world:
        api, robot = world.server.client_api, world.robot
        rights = api.rights(api.authenticate("admin-admin-admin"))
        views = world.server.gateway.status.tree_views
        await _looked(world, rights)
        for number in range(1, 1001):  # more than are looked at in one step
            robot.add(level(number, "A new level."))
        view = views.look(rights)
        assert not view.whole("alpha")
        assert view.mentions_hidden("alpha", "robot", "anything")
        view = await _looked(world, rights)
        assert view.whole("alpha")
        assert not view.mentions_hidden("alpha", "robot", "anything")


async def _looked(world: World, rights: Rights) -> TreeView:
    turns, views = world.server.client_api.turns, world.server.gateway.status.tree_views
    return await turns.finish("test", views.catch_up(rights))
