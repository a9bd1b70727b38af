"""Whatever a client can make grow has an end, and says where it is."""

from __future__ import annotations

from typing import Any

import pytest

from kernel.world import CONFIG, Client, World, world_of
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import Reply

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"


def refused(reply: dict[str, Any], code: str) -> dict[str, Any]:
    assert reply["status"] == "rejected", reply
    assert reply["error"]["code"] == code, reply
    return reply["error"]


async def test_own_fields_of_a_request(world: World) -> None:
    client = world.client()
    small = await client.ask(**{"type": "ping", "x-note": "n" * 16_000})
    assert small["x-note"] == "n" * 16_000
    big = await client.ask(**{"type": "ping", "x-note": "n" * 17_000})
    assert refused(big, "payload_too_large")["details"] == {"limit": 16_384}


async def test_options_of_a_subscription(world: World) -> None:
    client = world.client()
    where = {"field": "", "eq": "x" * 200_000}
    reply = await client.ask(type="subscribe", path=LEVEL, body={"where": where})
    assert refused(reply, "payload_too_large")["details"] == {"limit": 131_072}


async def test_paths_of_all_subscriptions_of_a_session() -> None:
    async with world_of("limits = {paths = 3}\n" + CONFIG) as world:
        client = world.client()
        for n in range(3):
            assert (await client.ask(type="subscribe", id=f"s{n}", path=LEVEL))[
                "status"
            ] == "completed"
        error = refused(await client.ask(type="subscribe", path=LEVEL), "payload_too_large")
        assert error["details"] == {"limit": 3}
        await client.ask(type="unsubscribe", id="s0")
        assert (await client.ask(type="subscribe", path=LEVEL))["status"] == "completed"
        assert (await world.client().ask(type="subscribe", path=LEVEL))["status"] == "completed"


async def test_terms_of_a_filter(world: World) -> None:
    where: dict[str, Any] = {"gt": 1}
    for _ in range(70):
        where = {"not": where}
    reply = await world.client().ask(type="subscribe", path=LEVEL, body={"where": where})
    assert reply["status"] == "rejected"


async def test_patterns_of_a_subscription(world: World) -> None:
    reply = await world.client().ask(
        type="subscribe", path=LEVEL, body={"paths": ["/sensor/*"] * 1001}
    )
    refused(reply, "payload_too_large")


def away(client: Client) -> Session:
    session = client.connection.session
    client.connection.close()
    return session


async def test_replies_for_a_client_that_is_away_in_number_and_bytes(world: World) -> None:
    client = world.client()
    known = (await client.ask(type="hello"))["body"]
    session = away(client)
    for n in range(5000):
        session.deliver(Reply(type="ping", id=str(n)))
    assert (len(session.missed), session.overflowed) == (4096, 904)
    for n in range(40):
        session.deliver(Reply(type="read", id=f"big{n}", body="x" * 1_000_000))
    assert session.missed_bytes <= 16 * 1024 * 1024
    assert session.missed_bytes == sum(size for _, size in session.missed)
    lost = session.overflowed
    back = world.client()
    await back.ask(type="hello", body={"session": known["session"]})
    reply = await back.until(lambda m: m.get("error", {}).get("code") == "gap")
    assert str(lost) in reply["message"]
    assert (await back.final("big39"))["status"] == "completed"
    assert session.missed_bytes == 0


async def test_feedback_for_a_client_that_is_away_is_the_newest_alone(world: World) -> None:
    client = world.client()
    await client.ask(type="hello")
    session = away(client)
    for n in range(100):
        session.deliver(
            Reply(type="execute", id="x", command="c", status="in_progress", body=n * 1000)
        )
    assert [reply.body for reply, _ in session.missed] == [99_000]
    assert session.missed_bytes == session.missed[0][1]


async def test_commands_that_a_session_has_given_are_forgotten_once_they_are_over(
    world: World,
) -> None:
    client = world.client()
    client.send(type="execute", path="/action/go", body=1)
    for n in range(600):
        reply = await client.ask(type="execute", path="/service/echo", body=str(n))
        assert reply["status"] == "completed", reply
    commands = client.connection.session.commands
    assert len(commands) <= 257
    assert next(iter(commands.values())).path == "/tenant/alpha/action/go"
