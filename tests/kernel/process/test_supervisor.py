"""A backend's troubles change its state; they never stop the gateway or leave a request unanswered."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from contextvars import ContextVar
from typing import Any

import pytest

from configuration import backend
from kernel.world import CONFIG, Client, NoOptions, Robot, World, prepared, world_of
from rcp_gateway.reload import apply
from rcp_gateway.server import Server, running
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, NotReady
from rcp_kernel.spi import BackendKind, Host

pytestmark = pytest.mark.anyio


async def state(client: Client) -> dict[str, Any]:
    return (await client.ask(type="status"))["body"]["backends"][0]


async def until_state(server: Server, wanted: str) -> dict[str, Any]:
    client = Client(server.client_api)
    while (found := await state(client))["state"] != wanted:
        await client.ask(type="ping")
    return found


@asynccontextmanager
async def gateway_with(lives: list[Exception | None]) -> AsyncGenerator[Server]:
    """Run a gateway whose backend meets the given fate at each attempt to open it."""

    @asynccontextmanager
    async def open_robot(_config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
        fate = lives.pop(0) if lives else None
        if fate is not None:
            raise fate
        robot = Robot(host)
        robot.declare()
        yield robot

    made = prepared(parse(CONFIG, "test"), [])
    made.plugins.backends["robot"] = BackendKind("robot", NoOptions, open_robot)
    async with running(made) as server:
        yield server


async def test_a_robot_that_is_not_there_yet_is_tried_again() -> None:
    async with gateway_with([NotReady("no cable"), ConnectionError("refused")]) as server:
        found = await until_state(server, "ready")
        assert found["last_error"] == "refused"


async def test_a_crash_is_tried_again_too() -> None:
    async with gateway_with([ZeroDivisionError("a bug")]) as server:
        await until_state(server, "ready")


async def test_a_wrong_configuration_is_not_tried_again() -> None:
    async with gateway_with([ConfigError("no such port")]) as server:
        found = await until_state(server, "down")
        assert found["detail"] == "no such port"
        assert server.tasks["robot"].done()


async def test_a_lost_link_ends_what_runs_and_comes_back_by_itself(world: World) -> None:
    client = world.client()
    id_ = client.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    world.robot.host.report("radio silence", down=True)
    final = await client.final(id_)
    assert (final["status"], final["error"]["code"]) == ("failed", "adapter_unavailable")
    assert "radio silence" in final["message"]
    refused = await client.ask(type="read", path="/sensor/level")
    assert refused["error"]["code"] == "adapter_unavailable"
    assert refused["error"]["retryable"] is True
    world.robot.host.report(None)
    world.robot.host.publish("sensor/level", 1.0)
    assert (await client.ask(type="read", path="/sensor/level"))["body"] == 1.0


async def test_withdrawing_a_path_ends_its_command(world: World) -> None:
    client = world.client()
    id_ = client.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    world.robot.remove("action/go")
    assert (await client.final(id_))["error"]["code"] == "adapter_unavailable"
    assert (await client.ask(type="execute", path="/action/go", body=1))["error"][
        "code"
    ] == "unknown_path"


async def test_two_backends_of_one_path_do_not_both_get_it() -> None:
    text = CONFIG + backend("second")
    async with world_of(text) as world:
        backends = (await world.client().ask(type="status"))["body"]["backends"]
        assert [b["state"] for b in backends] == ["ready", "down"]
        assert "is declared by backend 'robot' and by 'second'" in backends[1]["detail"]


async def test_a_reload_starts_and_stops_backends(world: World) -> None:
    text = CONFIG.replace('tenant = "alpha"', 'tenant = "beta"')
    made = prepared(parse(text, "test"), [])
    await apply(world.server, made)
    client = Client(world.server.client_api, "operator-operator")
    found = await until_state(world.server, "ready")
    assert found["tenant"] == "beta"
    paths = (await client.ask(type="discover", path="/**"))["body"]["resources"]
    assert paths
    assert all(p["path"].startswith(("/tenant/beta/", "/system/")) for p in paths)
    gone = await client.ask(type="read", path="/tenant/alpha/sensor/level")
    assert gone["error"]["code"] == "unknown_path"


@pytest.mark.parametrize("bug", [ZeroDivisionError, asyncio.CancelledError, GeneratorExit])
async def test_what_threads_hand_over_runs_in_order_each_in_its_own_context(
    world: World, bug: type[BaseException]
) -> None:
    host, caller = world.robot.host, ContextVar("caller", default="nobody")
    heard: list[tuple[int, str]] = []
    over = asyncio.Event()

    def hear(number: int) -> None:
        heard.append((number, caller.get()))
        if number == 1:
            raise bug("a bug")

    def hand_over() -> None:
        for number, name in enumerate(("ann", "ben", "cid")):
            caller.set(name)
            host.call_soon(hear, number)
        host.call_soon(over.set)

    await asyncio.get_running_loop().run_in_executor(None, hand_over)
    async with asyncio.timeout(60):
        await over.wait()
        assert heard == [(0, "ann"), (1, "ben"), (2, "cid")]
        over.clear()
        host.call_soon(over.set)  # what comes later wakes the loop again
        await over.wait()
