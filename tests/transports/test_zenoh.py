"""A robot's gateway and a hub, joined by Zenoh over a real socket."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager

import pytest

pytest.importorskip("zenoh")

from rcp_kernel.testing import BOUND, OPERATOR, MemoryClient, Served, serve

_KEYS = f'[[keys]]\nname = "operator"\nrole = "operator"\nkey = "{OPERATOR}"\n'
_OFF = "[transports]\nasgi = false\nhttp = false\nws = false\nsse = false\n"


def _robot(port: int) -> str:
    return (
        f'{_OFF}[transports.zenoh]\ngateway = "r7"\ntenant = "alpha"\n'
        f'connect = ["tcp/127.0.0.1:{port}"]\n'
        f'[[backends]]\nuse = "sim"\nname = "rover"\ntenant = "alpha"\n{_KEYS}'
    )


def _hub(port: int, token: str = OPERATOR) -> str:
    return (
        f'{_OFF}[[backends]]\nuse = "fleet"\nname = "fleet"\ntenant = "alpha"\n'
        f'hub = "h1"\nlisten = ["tcp/127.0.0.1:{port}"]\ntoken = "{token}"\n'
        f"{_KEYS}"
    )


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@asynccontextmanager
async def _serving(text: str) -> AsyncGenerator[Served]:
    from rcp_kernel.config.file import parse

    async with serve(parse(text, "test")) as served:
        yield served


async def _until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(BOUND):
        while not holds():
            await asyncio.sleep(0.01)


async def _appears(client: MemoryClient, path: str) -> dict[str, object]:
    async with asyncio.timeout(BOUND):
        while True:
            found = await client.request("discover", path=path, body={"limit": 100})
            if found["status"] == "completed" and found["body"]["resources"]:
                return found["body"]["resources"][0]
            await asyncio.sleep(0.01)


@asynccontextmanager
async def _fleet() -> AsyncGenerator[tuple[Served, Served, MemoryClient]]:
    port = _free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(_serving(_hub(port)))
        robot = await stack.enter_async_context(_serving(_robot(port)))
        client = hub.client(OPERATOR)
        stack.push_async_callback(client.close)
        await _appears(client, "/tenant/alpha/sensor/r7/pose")
        yield hub, robot, client


async def test_a_gateway_appears_with_the_schemas_of_its_robot() -> None:
    async with _fleet() as (_, robot, client):
        local = robot.client(OPERATOR)
        theirs = await _appears(local, "/tenant/alpha/sensor/pose")
        ours = await _appears(client, "/tenant/alpha/sensor/r7/pose")
        for schemas in (theirs["schemas"], ours["schemas"]):
            schemas["value"].pop("$id")  # type: ignore[index]
        assert ours["schemas"] == theirs["schemas"]
        await local.close()


async def test_a_value_is_read_and_written_through_the_hub() -> None:
    async with _fleet() as (_, _robot_gateway, client):
        read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
        assert read["status"] == "completed", read
        wrong = await client.request(
            "write", path="/tenant/alpha/param/r7/speed_limit", body="fast"
        )
        assert wrong["error"]["code"] == "invalid_value", wrong
        done = await client.request("write", path="/tenant/alpha/param/r7/speed_limit", body=0.5)
        assert done["status"] == "completed", done
        after = await client.request("read", path="/tenant/alpha/param/r7/speed_limit")
        assert after["body"] == 0.5


async def test_a_command_reports_feedback_and_one_result() -> None:
    async with _fleet() as (_, _robot_gateway, client):
        id_ = await client.send(
            type="execute", path="/tenant/alpha/action/r7/move_to", body={"position": {"x": 0.3, "y": 0.0}}
        )
        replies = await client.replies(id_)
        assert any(reply["status"] == "in_progress" for reply in replies), replies
        assert replies[-1]["status"] == "completed", replies[-1]


async def test_a_subscription_passes_values_on() -> None:
    async with _fleet() as (_, _robot_gateway, client):
        id_ = await client.subscribe("/tenant/alpha/sensor/r7/pose")
        first, second = await client.update(id_), await client.update(id_)
        assert second["seq"] > first["seq"]


async def test_a_gateway_that_leaves_is_down_and_comes_back_by_itself() -> None:
    port = _free_port()
    async with _serving(_hub(port)) as hub:
        client = hub.client(OPERATOR)
        async with _serving(_robot(port)):
            await _appears(client, "/tenant/alpha/sensor/r7/pose")
            await _until(lambda: str(hub.supervisor.state) == "ready")
        await _until(lambda: str(hub.supervisor.state) == "down")
        async with _serving(_robot(port)):
            await _until(lambda: str(hub.supervisor.state) == "ready")
            read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
            assert read["status"] == "completed", read
        await client.close()


async def test_a_hub_that_cannot_prove_itself_gets_nothing() -> None:
    port = _free_port()
    async with _serving(_hub(port, "nobody-knows-this-key")) as hub, _serving(_robot(port)):
        await _until(lambda: "r7" in str(hub.supervisor.detail))
        client = hub.client(OPERATOR)
        found = await client.request("discover", path="/tenant/alpha/**", body={"limit": 9})
        assert not [one for one in found["body"]["resources"] if "/r7/" in one["path"]]
        await client.close()
