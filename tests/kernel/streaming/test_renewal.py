"""Subscriptions to thousands of paths come under new rights, and back after a restart, in steps."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from configuration import key, role, rule
from kernel.judging import AT_ONCE, judged
from kernel.world import BOUND, CONFIG, Client, Robot, World, kept_in, world_of
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
PATHS = 5_000


def rules(*paths: str) -> str:
    return CONFIG + key("driver", "driver-driver-driver") + role("driver", rule("*", *paths))


class Many(Robot):
    """A robot with thousands of sensors."""

    def declare(self) -> None:
        """Put them into the tree."""
        for number in range(PATHS):
            name = f"sensor/{'odd' if number % 2 else 'even'}/level-{number:05}"
            self.add(Resource(name=name, description="A level.", value=int, live=True))


def linked(world: World) -> set[str]:
    there = world.server.gateway.registry.entries.values()
    return {e.path for e in there if e.tenant and e.listeners}


async def until(told: Callable[[], Any]) -> None:
    async with asyncio.timeout(3 * BOUND):
        while not told():  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0)


async def subscribed(world: World, client: Client) -> str:
    reply = await client.ask(type="subscribe", path="/sensor/**")
    await until(lambda: len(linked(world)) >= reply["body"]["count"])
    return reply["id"]


async def test_a_reload_takes_and_gives_thousands_of_paths_in_steps_and_sends_none_too_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with world_of(rules("/sensor/**"), Many) as world:
        client = world.client("driver-driver-driver")
        id_ = await subscribed(world, client)
        everything = linked(world)
        assert len(everything) == PATHS
        odd = {path for path in everything if "/odd/" in path}
        last = PATHS - PATHS % 2 - 2  # an even one that is judged among the last
        for paths, wanted in (("/sensor/odd/**", odd), ("/sensor/**", everything)):
            with judged(monkeypatch) as turns:
                world.server.gateway.reconfigure(parse(rules(paths), "test"))
                world.robot.host.publish(f"sensor/even/level-{last:05}", 1)
                world.robot.host.publish("sensor/odd/level-00001", 2)
                await until(lambda w=wanted: linked(world) == w)
            assert sum(turns) >= PATHS // 2
            assert max(turns) <= AT_ONCE
            update = await client.update(id_)
            assert (update["path"][-5:], update["body"]) == ("00001", 2)
        world.robot.host.publish(f"sensor/even/level-{last:05}", 3)
        while (update := await client.update(id_))["path"][-5:] == "00001":
            pass
        assert update["body"] in (1, 3)


async def test_a_client_that_leaves_while_its_rights_change_leaves_nothing_behind() -> None:
    async with world_of(rules("/sensor/**"), Many) as world:
        client = world.client("driver-driver-driver")
        id_ = client.send(type="subscribe", path="/sensor/**")
        await client.final(id_)
        world.server.gateway.reconfigure(parse(rules("/sensor/odd/**"), "test"))
        world.server.gateway.reconfigure(parse(rules("/**"), "test"))
        client.send(type="unsubscribe", body={"subscription": id_})
        await until(lambda: not linked(world))
        world.server.gateway.reconfigure(parse(rules("/sensor/**"), "test"))
        for _ in range(10):
            await asyncio.sleep(0)
        assert not linked(world)


async def test_a_subscription_to_thousands_of_paths_survives_a_restart_in_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = kept_in(tmp_path / "store.db", rules("/sensor/**"))
    async with world_of(config, Many) as world:
        client = world.client("driver-driver-driver")
        reply = (await client.ask(type="hello"))["body"]
        id_ = await subscribed(world, client)
    async with world_of(config, Many) as world:
        back = {key: reply[key] for key in ("session", "resume_token")}
        with judged(monkeypatch) as turns:
            client = world.client("driver-driver-driver")
            again = await client.ask(type="hello", body=back)
            assert again["body"]["session"] == reply["session"]
            await until(lambda: len(linked(world)) == PATHS)
        assert sum(turns) >= PATHS
        assert max(turns) <= AT_ONCE
        world.robot.host.publish("sensor/odd/level-00001", 5)
        assert (await client.update(id_))["body"] == 5
