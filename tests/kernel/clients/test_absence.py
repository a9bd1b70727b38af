"""While a client is away, and while the tree changes under a subscription."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from kernel.world import BOUND, CONFIG, Client, World
from rcp_kernel.config.file import parse
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity
from rcp_streams import demand

pytestmark = pytest.mark.anyio
LAZY = "/tenant/alpha/sensor/lazy"


async def greeted(client: Client, **body: Any) -> dict[str, Any]:
    reply = await client.ask(type="hello", body=body)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def subscribed(client: Client, path: str, **options: Any) -> str:
    reply = await client.ask(type="subscribe", path=path, body=options)
    return reply["body"]["subscription"]


async def settled(world: World, condition: Any) -> None:
    """Let the loop turn until a condition holds."""
    async with asyncio.timeout(BOUND):
        while not condition():
            await world.client().ask(type="ping")


async def test_a_source_goes_on_while_its_client_is_away_and_stops_when_it_is_given_up(
    world: World,
) -> None:
    client = world.client()
    await greeted(client)
    id_ = await subscribed(client, "/sensor/lazy")
    await client.update(id_)
    session = client.connection.session
    client.connection.close()
    await world.client().ask(type="ping")
    assert world.robot.left == []
    world.server.gateway.sessions.drop(session)
    await settled(world, lambda: len(world.robot.left) == len(world.robot.watched))
    assert world.server.gateway.registry.entries[LAZY].listeners == []


async def test_any_number_of_clients_that_are_away_make_one_listener_and_the_last_takes_it_along(
    world: World,
) -> None:
    entry = world.server.gateway.registry.entries[LAZY]
    sessions: list[Any] = []
    for rate in (1, 5, None, 5):
        client = world.client()
        await greeted(client)
        await client.update(
            await subscribed(client, "/sensor/lazy", **({} if rate is None else {"rate": rate}))
        )
        sessions.append(client.connection.session)
        client.connection.close()
    assert len(entry.listeners) == 1
    wanted: list[float | None] = []
    for session in reversed(sessions):
        wanted.append(entry.listeners[0].rate)  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]
        world.server.gateway.sessions.drop(session)
    assert wanted == [None, None, 5, 1]
    assert entry.listeners == []


async def test_rules_that_forbid_a_path_to_who_is_away_let_its_source_go(world: World) -> None:
    client = world.client()
    await greeted(client)
    id_ = await subscribed(client, "/sensor/lazy")
    await client.update(id_)
    client.connection.close()
    text = CONFIG.replace('role = "operator"', 'role = "none"') + "[roles.none]\n"
    world.server.gateway.reconfigure(parse(text, "test"))
    assert world.server.gateway.registry.entries[LAZY].listeners == []


async def test_what_appears_while_a_client_is_away_reaches_it_once_on_return(world: World) -> None:
    client = world.client()
    facts = await greeted(client)
    id_ = await subscribed(client, "/sensor/*", qos={"depth": 10})
    client.connection.close()
    world.robot.add(Resource(name="sensor/new", description="New.", value=quantity("m"), live=True))
    world.robot.host.publish("sensor/new", 1.0)
    back = world.client()
    await greeted(back, session=facts["session"], resume_token=facts["resume_token"])
    world.robot.host.publish("sensor/new", 2.0)
    assert [(await back.update(id_))["body"] for _ in range(2)] == [1.0, 2.0]
    await back.ask(type="ping")
    assert not [m for m in back.inbox if m["type"] == "update"]


async def test_a_resource_declared_anew_is_not_stale_while_it_publishes(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, "/sensor/level")
    world.robot.host.publish("sensor/level", 1.0)
    await client.update(id_)
    entries = world.server.gateway.registry.entries
    old = entries["/tenant/alpha/sensor/level"]
    world.robot.add(
        Resource(
            name="sensor/level",
            description="A level, described anew.",
            value=quantity("m"),
            live=True,
            deadline=0.2,
        )
    )
    async with asyncio.timeout(BOUND):
        while not old.stale:
            world.robot.host.publish("sensor/level", 2.0)
            await client.update(id_)
    world.server.gateway.hub.deadline_monitor.poll()
    await client.ask(type="ping")
    assert not [m for m in client.inbox if m.get("code") == "stale"]
    assert (await client.notice("stale"))["path"] == "/tenant/alpha/sensor/level"


async def test_a_watch_that_failed_is_entered_again(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demand, "_WATCH_RETRY", 0.01)
    watch, tries = world.robot.watch, 0

    def sometimes(name: str, rate: float | None) -> Any:
        nonlocal tries
        tries += 1
        if tries == 1:
            raise AdapterUnavailable("not now")
        return watch(name, rate)

    world.robot.watch = sometimes
    client = world.client()
    id_ = await subscribed(client, "/sensor/lazy")
    assert (await client.update(id_))["body"] == 7.0
