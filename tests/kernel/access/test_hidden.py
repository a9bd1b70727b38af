"""What the rules hide inside one's own tenant is in no log, audit, count, lease or envelope."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from typing import Any

import pytest
import structlog

from configuration import key, role, rule
from kernel.world import CONFIG, Client, World, world_of
from rcp_kernel.model import Resource
from steps import finished

pytestmark = pytest.mark.anyio
TOKEN = "auditor-auditor-auditor"
RULES = (
    CONFIG
    + key("auditor", TOKEN)
    + role(
        "auditor",
        rule("*", "/**", "/system/**"),
        deny=[rule("*", "/service/secret", "/sensor/hush", "/actuator/secret/**", "/sensor/place")],
    )
    + """
[[envelopes]]
name = "yard"
paths = ["/actuator/drive"]
fence = { of = "sensor/place", point = ["0", "1"], inside = { yard = [[0, 0], [1, 0], [1, 1]] } }
"""
)
HIDDEN, GIVEN = "/tenant/alpha/service/secret", "/tenant/alpha/service/echo"


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    """A robot, and somebody who may see everything of it but a few paths."""
    async with world_of(RULES) as made:
        made.robot.add(
            Resource(name="service/secret", description="Answers.", input=str, output=str),
            Resource(name="actuator/secret/arm", description="An arm.", value=float),
            Resource(name="sensor/hush", description="Quiet.", value=float, deadline=1.0),
            Resource(name="sensor/place", description="A place.", value=tuple[float, float]),
        )
        made.robot.execute = _echo
        yield made


async def _echo(_name: str, value: Any, _progress: Any) -> Any:
    return value


async def body(client: Client, path: str) -> Any:
    reply = await client.ask(type="read", path=path)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def test_log_records_that_name_something_hidden_are_not_shown(world: World) -> None:
    client = world.client(TOKEN)
    await client.ask(type="subscribe", id="log", path="/system/log", body={"qos": {"depth": 9}})
    log = structlog.get_logger("test")
    log.warning("by path", path=HIDDEN)
    log.warning("in words", why=f"{HIDDEN}: so.")
    log.warning("by name", backend="robot", detail="output of service/secret: no text")
    log.warning("plain", path=GIVEN)
    assert (await client.update("log"))["body"]["message"] == "plain"
    warnings = (await body(client, "/system/status"))["warnings"]
    assert [record["message"] for record in warnings] == ["plain"]


async def test_records_of_what_is_hidden_are_not_shown(world: World) -> None:
    client, other = world.client(TOKEN), world.client()
    await client.ask(type="subscribe", id="a", path="/system/audit", body={"qos": {"depth": 99}})
    await other.ask(type="execute", path=HIDDEN, body="x")
    await other.ask(type="execute", path=GIVEN, body="x")
    seen: list[Any] = []
    while len(seen) < 2:
        record = (await client.update("a"))["body"]
        seen += [record["path"]] if "path" in record else []
    assert seen == [GIVEN, GIVEN]


async def test_commands_on_what_is_hidden_are_not_counted(world: World) -> None:
    client, other = world.client(TOKEN), world.client()
    before = (await body(client, "/system/status"))["commands"]
    await other.ask(type="execute", path=HIDDEN, body="x")
    assert (await body(client, "/system/status"))["commands"] == before
    await other.ask(type="execute", path=GIVEN, body="x")
    after = (await body(client, "/system/status"))["commands"]
    assert after["completed"] == before["completed"] + 1
    assert {c["path"] for c in await body(client, "/system/commands")} == {GIVEN}


async def test_a_lease_on_something_hidden_is_in_the_way_without_its_name(world: World) -> None:
    client, other = world.client(TOKEN), world.client()
    asked = {"do": "acquire", "scope": "/tenant/alpha/actuator/secret"}
    await other.ask(type="execute", path="/system/leases", body=asked)
    refused = await client.ask(
        type="execute", path="/system/leases", body={"do": "acquire", "scope": "/tenant/alpha"}
    )
    assert refused["error"]["code"] == "lease_held"
    assert refused["error"]["details"]["scope"] == "/tenant/alpha"
    assert "secret" not in json.dumps(refused)
    assert await body(client, "/system/leases") == []


async def test_a_fence_does_not_name_the_sensor_that_is_hidden(world: World) -> None:
    reply = await world.client(TOKEN).ask(type="discover", path="/actuator/drive")
    [found] = reply["body"]["resources"]
    assert found["envelopes"][0]["envelope"] == "yard"
    assert "place" not in json.dumps(found)
    seen = await world.client().ask(type="discover", path="/actuator/drive")
    assert "sensor/place" in json.dumps(seen)


async def test_metrics_do_not_name_what_is_hidden(world: World) -> None:
    world.robot.host.publish("sensor/hush", 1.0)
    client_api = world.server.client_api
    client, other = world.client(TOKEN), world.client()
    assert b"/sensor/hush" in finished(client_api.metrics(other.connection.session))
    assert b"/sensor/hush" not in finished(client_api.metrics(client.connection.session))
