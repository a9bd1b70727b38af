"""What one client asks for, or one robot says, does not reach the other clients."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from kernel.world import CONFIG, Client, World, world_of
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"


async def subscribed(client: Client, path: str = LEVEL, **options: Any) -> str:
    reply = await client.ask(type="subscribe", path=path, body=options)
    assert reply["status"] == "completed", reply
    return reply["body"]["subscription"]


@pytest.mark.parametrize("reliability", ["best_effort", "reliable"])
async def test_an_unsubscribe_with_updates_waiting_disturbs_nobody(
    world: World, reliability: str
) -> None:
    leaving, staying = world.client(), world.client()
    gone = await subscribed(leaving, qos={"reliability": reliability})
    id_ = await subscribed(staying)
    world.robot.host.publish("sensor/level", 1.0)
    reply = await leaving.ask(type="unsubscribe", body={"subscription": gone})
    assert reply["status"] == "completed"
    assert (await staying.update(id_))["body"] == 1.0


async def test_an_overrun_costs_the_next_listener_no_sample(world: World) -> None:
    client = world.client()
    await subscribed(client, qos={"reliability": "reliable", "depth": 2})
    id_ = await subscribed(client, qos={"reliability": "reliable", "depth": 10})
    for value in (1.0, 2.0, 3.0, 4.0):
        world.robot.host.publish("sensor/level", value)
    assert [(await client.update(id_))["body"] for _ in range(4)] == [1.0, 2.0, 3.0, 4.0]


async def test_a_field_asked_for_with_the_whole_around_it_is_there_once(world: World) -> None:
    world.robot.add(Resource(name="sensor/any", description="Anything.", value=dict[str, Any]))
    client, other = world.client(), world.client()
    id_ = await subscribed(client, "/sensor/any", fields=["a", "a.b"])
    level = await subscribed(other)
    world.robot.host.publish("sensor/any", {"a": 5})
    world.robot.host.publish("sensor/level", 1.0)
    assert (await other.update(level))["body"] == 1.0
    assert (await client.update(id_))["body"] == {"a": 5}


@pytest.mark.parametrize("index", ["²", "9" * 5000, "7"])
async def test_a_place_that_no_list_has_is_a_field_that_is_not_there(
    world: World, index: str
) -> None:
    world.robot.add(
        Resource(name="sensor/pair", description="Two.", value=tuple[float, float], live=True)
    )
    client = world.client()
    where = {"field": index, "gt": 0}
    reply = await client.ask(type="subscribe", path="/sensor/pair", body={"where": where})
    assert reply["error"]["code"] == "filter_unsupported"
    world.robot.host.publish("sensor/pair", (1.0, 2.0))
    reply = await client.ask(type="read", path="/sensor/pair", body={"fields": [index]})
    assert reply["error"]["code"] == "filter_unsupported"


async def test_a_text_that_cannot_be_written_is_the_robots_fault_alone(world: World) -> None:
    world.robot.add(Resource(name="sensor/text", description="A text.", value=str))
    client, other = world.client(), world.client()
    id_ = await subscribed(client, "/sensor/text")
    level = await subscribed(other)
    world.robot.host.publish("sensor/text", "\ud800")
    world.robot.host.publish("sensor/level", 1.0)
    assert (await other.update(level))["body"] == 1.0
    world.robot.host.publish("sensor/text", "good")
    assert (await client.update(id_))["body"] == "good"


async def test_a_time_that_no_calendar_has_becomes_that_of_receipt(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client)
    world.robot.host.publish("sensor/level", 1.0, 10**40)
    assert (await client.update(id_))["timestamp"].startswith("20")


async def test_feedback_that_cannot_be_written_goes_without_its_body(world: World) -> None:
    world.robot.add(Resource(name="action/talk", description="Talks.", feedback=str))
    go_on = asyncio.Event()

    async def talk(_name: str, _value: Any, progress: Progress) -> None:
        progress("\ud800")
        await go_on.wait()

    world.robot.execute = talk
    client = world.client()
    id_ = client.send(type="execute", path="/action/talk")
    reply = await client.until(lambda m: m.get("status") == "in_progress")
    assert "body" not in reply
    go_on.set()
    assert (await client.final(id_))["status"] == "completed"


async def test_a_field_of_ones_own_that_json_cannot_carry_is_refused(world: World) -> None:
    client_api = world.server.client_api
    connection = client_api.connect(
        client_api.authenticate("operator-operator"), Encoding.MSGPACK, lambda: None
    )
    for odd in (msgspec.msgpack.Ext(5, b"a"), {(1, 2): 3}):
        envelope = {"type": "ping", "id": "1", "x-odd": odd}
        connection.receive(msgspec.msgpack.encode(envelope))
        [data] = connection.outbox.collect()
        assert msgspec.msgpack.decode(data)["error"]["code"] == "bad_request"


async def test_an_integer_of_any_length_neither_ends_nor_blocks_its_command(
    tmp_path: Path,
) -> None:
    async with world_of(CONFIG + f'[store]\npath = "{tmp_path}/commands.db"\n') as world:
        world.robot.add(Resource(name="service/any", description="Takes anything.", input=Any))

        async def nothing(_name: str, _value: Any, _progress: Progress) -> None:
            return None

        world.robot.execute = nothing
        reply = await world.client().ask(type="execute", path="/service/any", body=10**30)
        assert reply["status"] == "completed"


@pytest.mark.parametrize("stamp", [10**30, 1e300, -1e300])
async def test_a_timestamp_past_every_calendar_is_no_time(world: World, stamp: float) -> None:
    reply = await world.client().ask(type="ping", timestamp=stamp)
    assert reply["error"]["code"] == "bad_request"


async def test_a_history_longer_than_all_time_is_all_there_is(world: World) -> None:
    world.robot.host.publish("sensor/level", 1.0)
    client = world.client()
    id_ = await subscribed(client, history="1e300h")
    assert (await client.update(id_))["body"] == 1.0


async def test_a_count_is_of_the_whole_subscription_not_of_each_path(world: World) -> None:
    world.robot.add(
        Resource(name="sensor/other", description="Another.", value=quantity("m"), live=True)
    )
    world.robot.host.publish("sensor/level", 1.0)
    world.robot.host.publish("sensor/other", 1.0)
    client = world.client()
    await subscribed(client, "/sensor/*", count=1)
    await client.notice("subscription_ended")
    assert len([m for m in client.inbox if m["type"] == "update"]) == 1


async def test_what_waited_at_the_end_of_a_subscription_is_framed_once(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, qos={"reliability": "reliable"})
    outbox = client.connection.outbox
    outbox.framing = lambda _size, _text: b"#"
    [subscription] = client.connection.session.subscriptions.values()
    world.robot.host.publish("sensor/level", 1.0)
    subscription.end(subscription, "duration", None)
    said = b"".join(outbox.collect())
    outbox.framing = None
    assert [json.loads(part)["type"] for part in said.split(b"#")[1:]] == ["update", "notice"]
    assert id_.encode() in said


async def test_hello_where_there_is_no_connection_is_refused_by_name(world: World) -> None:
    client_api = world.server.client_api
    session = client_api.session(client_api.authenticate("operator-operator"))
    reply = await client_api.request(session, Request(type="hello"))
    assert reply.error is not None
    assert reply.error["code"] == "unsupported_operation"


async def test_who_is_expelled_may_do_nothing_from_then_on(world: World) -> None:
    client = world.client()
    other = CONFIG.replace('"operator-operator"', '"another-operator"')
    world.server.gateway.reconfigure(parse(other, "test"))
    reply = await client.ask(type="write", path="/param/limit", body=1.0)
    assert reply["error"]["code"] == "unknown_path"


@pytest.mark.parametrize("path", ["actuator/**", "/actu ator", "/a//b"])
def test_a_rule_that_could_never_hold_is_refused_with_its_table(path: str) -> None:
    role = f'[roles.x]\ndeny = [{{operations = ["write"], paths = ["{path}"]}}]\n'
    with pytest.raises(ConfigError, match=r"test\.toml: \[roles\.x\]"):
        parse(CONFIG + role, "test.toml")
