"""Subscriptions to thousands of paths come, go and return in steps, and nobody notices but by time."""

from __future__ import annotations

import asyncio
import gc
import json
import time
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import pytest

from kernel.world import BOUND, CONFIG, Client, Robot, World, world_of
from rcp_kernel.model import Resource
from rcp_kernel.tree.entry import Entry

pytestmark = pytest.mark.anyio
PATHS = 1500
EVERY = {"qos": {"reliability": "reliable"}}


class Many(Robot):
    """A robot with many sensors."""

    paths = PATHS

    def declare(self) -> None:
        """Put them into the tree, each with a value."""
        for name in self.names():
            self.add(Resource(name=name, description="A level.", value=int, live=True))
            self.host.publish(name, 1)

    def names(self) -> list[str]:
        return [f"sensor/level-{n:05}" for n in range(self.paths)]

    def publish(self, value: int) -> None:
        for name in self.names():
            self.host.publish(name, value)


class Most(Many):
    """A robot with as many as one session may subscribe to."""

    paths = 20_000


class Listening(Client):
    """A client that counts updates as they come, and keeps the rest."""

    def updates(self) -> list[dict[str, Any]]:
        found = [m for m in self.inbox if m["type"] == "update"]
        self.inbox = [m for m in self.inbox if m["type"] != "update"]
        return found


class Counting(Client):
    """A client that only counts updates."""

    count = 0

    def _flush(self) -> None:
        outbox = self.connection.outbox
        for data in outbox.collect():
            if data.startswith(b'{"type":"update"'):
                self.count += 1
            else:
                self.inbox.append(json.loads(data))
        outbox.again()
        self._arrived.set()


@asynccontextmanager
async def many(make: type[Many] = Many) -> AsyncGenerator[World]:
    async with world_of(CONFIG, make) as world:
        yield world


def listening(world: World) -> Listening:
    return Listening(world.server.client_api, "operator-operator")


def robot_of(world: World) -> Many:
    assert isinstance(world.robot, Many)
    return world.robot


def entries(world: World) -> list[Entry]:
    return [e for e in world.server.gateway.registry.entries.values() if e.tenant == "alpha"]


def listeners(world: World) -> int:
    return sum(len(entry.listeners) for entry in entries(world))


async def until(told: Callable[[], Any], bound: float = 3 * BOUND) -> None:
    async with asyncio.timeout(bound):
        while not told():  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0)


async def received(client: Listening, count: int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []

    def enough() -> bool:
        found.extend(client.updates())
        return len(found) >= count

    await until(enough)
    return found


@contextmanager
def longest_turn() -> Generator[list[float]]:
    """Tell how much of the processor one turn of the loop took at most, in seconds."""
    loop, worst, last, done = asyncio.get_running_loop(), [0.0], time.thread_time(), False

    def look() -> None:
        nonlocal last
        moment = time.thread_time()
        worst[0], last = max(worst[0], moment - last), moment
        if not done:
            loop.call_soon(look)

    gc.disable()  # as a gateway has it while something moves
    look()
    try:
        yield worst
    finally:
        done = True
        gc.enable()


@pytest.mark.serial
async def test_no_turn_of_the_loop_is_long_whatever_becomes_of_20_000_paths() -> None:
    async with many(Most) as world:
        client = Counting(world.server.client_api, "operator-operator")
        reply = (await client.ask(type="hello"))["body"]
        back = {key: reply[key] for key in ("session", "resume_token")}
        with longest_turn() as worst:
            id_ = client.send(type="subscribe", path="/sensor/**", body=EVERY)
            await until(lambda: client.count == Most.paths)
            await client.ask(type="unsubscribe", body={"subscription": id_})
            client.send(type="subscribe", path="/sensor/**", body=EVERY)
            await until(lambda: client.count == 2 * Most.paths)
            client.connection.close()
            again = Counting(world.server.client_api, "operator-operator")
            again.send(type="hello", body=back)
            robot_of(world).host.publish("sensor/level-00000", 2)
            await until(lambda: again.count)
            world.server.gateway.sessions.drop(again.connection.session)
            await until(lambda: not listeners(world))
    assert worst[0] < 0.1


async def test_what_is_published_after_the_reply_is_not_missed() -> None:
    async with many() as world:
        client = listening(world)
        for initial in (True, False):
            id_ = client.send(
                type="subscribe", path="/sensor/**", body={**EVERY, "initial": initial}
            )
            await client.final(id_)
            robot_of(world).publish(2)
            robot_of(world).publish(3)
            each = 3 if initial else 2
            found = await received(client, each * PATHS)
            values: dict[str, list[int]] = {}
            for update in found:
                values.setdefault(update["path"], []).append(update["body"])
            assert {tuple(one)[-2:] for one in values.values()} == {(2, 3)}
            assert {len(one) for one in values.values()} == {each}
            await client.ask(type="unsubscribe", id=id_)


async def test_subscribing_and_unsubscribing_in_one_breath_leaves_what_was_said_last() -> None:
    async with many() as world:
        client = listening(world)
        for _ in range(3):
            client.send(type="subscribe", id="one", path="/sensor/**", body={"history": 10})
            client.send(type="unsubscribe", id="one")
        client.send(type="subscribe", id="one", path="/sensor/level-00000")
        replies = [await client.final("one") for _ in range(7)]
        kinds = [reply["type"] for reply in replies]
        assert kinds == ["subscribe", "unsubscribe"] * 3 + ["subscribe"]
        assert {reply["status"] for reply in replies} == {"completed"}
        await until(lambda: listeners(world) == 1)


async def test_nothing_comes_after_the_reply_to_unsubscribe() -> None:
    async with many() as world:
        client = listening(world)
        client.send(type="subscribe", id="one", path="/sensor/**", body=EVERY)
        await client.final("one")
        client.send(type="unsubscribe", id="one")
        robot_of(world).publish(2)
        await client.final("one")
        client.updates()
        robot_of(world).publish(3)
        await client.ask(type="ping")
        assert not client.updates()
        assert not listeners(world)


async def test_a_client_that_goes_while_it_subscribes_leaves_nothing_behind() -> None:
    async with many() as world:
        client = listening(world)
        await client.final(client.send(type="subscribe", path="/sensor/**"))
        client.connection.close()
        await until(lambda: not listeners(world))
        assert not world.server.gateway.hub.subscriptions


async def test_a_client_that_comes_back_while_it_subscribes_has_every_path_once() -> None:
    async with many() as world:
        client = listening(world)
        reply = (await client.ask(type="hello"))["body"]
        back = {"type": "hello", "body": {k: reply[k] for k in ("session", "resume_token")}}
        await client.final(client.send(type="subscribe", path="/sensor/**", body=EVERY))
        found: list[dict[str, Any]] = []
        for _ in range(3):  # at once, and while its paths are still brought back
            client.connection.close()
            found += client.updates()
            client = listening(world)
            await client.ask(**back)
        robot_of(world).publish(2)
        found += await received(client, 2 * PATHS - len(found))
        assert len({update["path"] for update in found}) == PATHS
        last = {update["path"]: update["body"] for update in found}
        assert set(last.values()) == {2}
        numbers = [(update["path"], update["seq"]) for update in found]
        assert len(set(numbers)) == len(numbers)
        await until(lambda: listeners(world) == PATHS)


async def test_a_subscription_ends_once_and_says_so_last() -> None:
    async with many() as world:
        client = listening(world)
        body = {**EVERY, "duration": 0.001}
        await client.final(client.send(type="subscribe", id="short", path="/sensor/**", body=body))
        notice = await client.notice("subscription_ended")
        assert notice["reason"] == "duration"
        client.updates()
        robot_of(world).publish(2)
        await client.ask(type="ping")
        assert not client.updates()
        await until(lambda: not listeners(world))


async def test_what_goes_from_the_tree_meanwhile_is_told_of() -> None:
    async with many() as world:
        client = listening(world)
        await client.final(client.send(type="subscribe", id="some", path="/sensor/**"))
        last = f"sensor/level-{PATHS - 1:05}"
        robot_of(world).remove(last)
        notice = await client.notice("resource_removed")
        assert notice["path"].endswith(last)
        host = robot_of(world).host
        host.declare(Resource(name=last, description="A level.", value=int, live=True))
        assert (await client.notice("resource_added"))["path"] == notice["path"]
        host.publish(last, 7)
        await client.until(lambda m: m.get("path") == notice["path"] and m.get("body") == 7)
