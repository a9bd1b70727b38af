"""A robot's gateway and a hub, joined by Zenoh over a real socket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from typing import Any

import pytest

from configuration import backend, configuration, key, table

pytest.importorskip("zenoh")

from ports import free_port
from rcp_gateway.testing import BOUND, OPERATOR, MemoryClient, Served, eventually, serve
from rcp_gateway.testing.wire import ROBOT
from transports.cable import Cable

_OPERATOR = key("operator", OPERATOR)
_LINK = "/tenant/alpha/sensor/r7/link"


def _robot(port: int, use: str = "sim", **fields: Any) -> str:
    hub = [f"tcp/127.0.0.1:{port}"]
    return configuration(
        table("transports.zenoh", gateway="r7", tenant="alpha", connect=hub, **fields),
        backend("rover", use=use),
        _OPERATOR,
    )


def _hub(port: int, token: str = OPERATOR) -> str:
    listen = [f"tcp/127.0.0.1:{port}"]
    fleet = backend("fleet", use="fleet", hub="h1", listen=listen, token=token)
    return configuration(fleet, _OPERATOR)


@asynccontextmanager
async def _serving(text: str) -> AsyncGenerator[Served]:
    from rcp_kernel.config.file import parse

    async with serve(parse(text, "test"), ROBOT) as served:
        yield served


async def _comes(holds: Callable[[], bool], what: str) -> None:
    async def look() -> bool:
        return holds()

    await eventually(look, what)


async def _appears(client: MemoryClient, path: str) -> dict[str, object]:
    async with asyncio.timeout(BOUND):
        while True:
            found = await client.request("discover", path=path, body={"limit": 100})
            if found["status"] == "completed" and (shown := _of_robots(found)):
                return shown[0]
            await asyncio.sleep(0.01)


def _of_robots(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Leave out what the hub itself has of a robot."""
    return [one for one in found["body"]["resources"] if one["path"] != _LINK]


@asynccontextmanager
async def _fleet(
    use: str = "sim", **fields: Any
) -> AsyncGenerator[tuple[Served, Served, MemoryClient]]:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(_serving(_hub(port)))
        robot = await stack.enter_async_context(_serving(_robot(port, use, **fields)))
        client = hub.client(OPERATOR)
        stack.push_async_callback(client.close)
        await _appears(client, "/tenant/alpha/*/r7/**")
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
            type="execute",
            path="/tenant/alpha/action/r7/move_to",
            body={"position": {"x": 0.3, "y": 0.0}},
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
    port = free_port()
    async with _serving(_hub(port)) as hub:
        client = hub.client(OPERATOR)
        async with _serving(_robot(port)):
            await _appears(client, "/tenant/alpha/sensor/r7/pose")
            await _comes(lambda: hub.supervisor.unit("r7").state == "ready", "the robot is ready")
        await _comes(lambda: hub.supervisor.unit("r7").state == "down", "the robot is down")
        async with _serving(_robot(port)):
            await _comes(lambda: hub.supervisor.unit("r7").state == "ready", "the robot is ready")
            read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
            assert read["status"] == "completed", read
        await client.close()


async def test_a_hub_has_no_more_links_than_a_gateway_can_bear() -> None:
    from rcp_zenoh.session import configuration as zenoh_configuration
    from rcp_zenoh.session import opened

    port = free_port()
    async with _serving(_hub(port)) as hub, _serving(_robot(port)) as robot:
        client = hub.client(OPERATOR)
        await _appears(client, "/tenant/alpha/*/r7/**")
        (facts,) = [one for one in robot.server.status.transports if "links" in one]
        config = zenoh_configuration("client", connect=[f"tcp/127.0.0.1:{port}"])
        async with opened(config, patient=False) as peer:
            names = (*(f"evil/{number}" for number in range(300)), "other/last")
            say = peer.liveliness().declare_token
            tokens = await asyncio.to_thread(lambda: [say(f"rcp/alpha/r7/link/{n}") for n in names])
            await _comes(lambda: "other" in [one["hub"] for one in facts["links"]], "the last one")
            assert {one["hub"]: one["links"] for one in facts["links"]}["evil"] == 256
            del tokens
        read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
        assert read["status"] == "completed", read
        await client.close()


async def test_a_hub_that_cannot_prove_itself_gets_nothing() -> None:
    port = free_port()
    async with _serving(_hub(port, "nobody-knows-this-key")) as hub, _serving(_robot(port)):
        await _comes(lambda: bool(hub.supervisor.unit("r7").detail), "the refusal is in the status")
        client = hub.client(OPERATOR)
        found = await client.request("discover", path="/tenant/alpha/**", body={"limit": 9})
        assert not [one for one in _of_robots(found) if "/r7/" in one["path"]]
        link = await client.request("read", _LINK)
        assert (link["body"]["state"], link["body"]["detail"]) == ("down", "unknown token")
        await client.close()


async def test_a_command_outlives_a_cut_link_and_ends_once() -> None:
    port = free_port()
    async with (
        _serving(_hub(port)) as hub,
        Cable(port).laid() as cable,
        _serving(_robot(cable.port)) as robot,
    ):
        client = hub.client(OPERATOR)
        await _appears(client, "/tenant/alpha/sensor/r7/pose")
        body = {"position": {"x": 1.5, "y": 0.0}}
        id_ = await client.send(type="execute", path="/tenant/alpha/action/r7/move_to", body=body)
        await client.until(lambda m: m.get("id") == id_ and m.get("status") == "in_progress")
        cable.cut()
        replies = await client.replies(id_, BOUND)
        assert replies[-1]["status"] == "completed", replies[-1]
        local = robot.client(OPERATOR)
        commands = await local.request("read", "/system/commands")
        assert len(commands["body"]) == 1, commands
        await local.close()
        await client.close()


async def test_a_robot_finds_a_hub_that_was_restarted() -> None:
    port = free_port()
    async with AsyncExitStack() as first, AsyncExitStack() as stack:
        hub = await first.enter_async_context(_serving(_hub(port)))
        await stack.enter_async_context(_serving(_robot(port)))
        await _appears_at(hub, stack)
        await first.aclose()
        await _appears_at(await stack.enter_async_context(_serving(_hub(port))), stack)


async def _appears_at(hub: Served, stack: AsyncExitStack) -> None:
    client = hub.client(OPERATOR)
    stack.push_async_callback(client.close)
    await _appears(client, "/tenant/alpha/sensor/r7/pose")


async def test_status_shows_each_link() -> None:
    async with _fleet() as (_, robot, _client):

        def link() -> dict[str, Any]:
            (transport,) = robot.server.gateway.status.transports
            return transport["links"][0]

        await _comes(lambda: "latency" in link(), "the link is measured")
        assert link()["hub"] == "h1"
        assert link()["links"] == 1
        assert link()["lost"] == 0
        assert link()["received"] > 0
        assert link()["sent"] > link()["received"]
        assert abs(link()["clock_offset"]) <= link()["clock_bound"] + 0.001


async def test_a_long_value_arrives() -> None:
    async with _fleet("wire-robot") as (_, robot, client):
        for value in ("x" * 1_000_000, "short"):
            robot.life.host.publish("event/note", value)
            read = await client.request("read", "/tenant/alpha/event/r7/note")
            assert read["body"] == value


async def test_a_budget_skips_updates_and_delays_no_command() -> None:
    async with _fleet("wire-robot", budget=20_000) as (_, robot, client):
        publish = partial(robot.life.host.publish, "event/note")
        path = "/tenant/alpha/event/r7/note"
        id_ = await client.subscribe(path, qos={"depth": 100}, initial=False)
        (transport,) = robot.server.gateway.status.transports
        row, loop = transport["links"][0], asyncio.get_running_loop()
        await _comes(lambda: "sent" in row, "the link is measured")
        before, began = row["sent"], loop.time()
        update = None
        for number in range(200):
            publish(f"{number} {'x' * 1000}")
            done = await client.request("write", "/tenant/alpha/param/r7/label", body="a")
            assert done["status"] == "completed", done
        publish("last")
        while update is None or update["body"] != "last":
            update = await client.update(id_)
        replies = 200 * 400
        allowed = 20_000 * (loop.time() - began) + 20_000 + replies
        await _comes(lambda: row["sent"] > before, "the link is measured again")
        assert row["sent"] - before < allowed
