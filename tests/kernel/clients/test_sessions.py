"""Sessions survive a cut; what was missed is replayed, or its loss is told."""

from __future__ import annotations

from typing import Any

import pytest

from kernel.world import CONFIG, Client, World, prepared, world_of
from rcp_gateway.reload import apply
from rcp_gateway.testing import SteppedClock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import QueueFull

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"
RELIABLE = {"qos": {"reliability": "reliable", "depth": 1000}}


async def greeted(client: Client, **body: Any) -> dict[str, Any]:
    reply = await client.ask(type="hello", body=body)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def test_hello_says_who_one_is_and_what_holds(world: World) -> None:
    facts = await greeted(world.client(None), token="operator-operator")
    assert (facts["principal"], facts["tenant"], facts["version"]) == ("operator", "alpha", "1")
    assert facts["limits"]["message"] > 0


async def test_a_client_that_comes_back_gets_what_it_missed_and_nothing_twice(world: World) -> None:
    client = world.client()
    session = await greeted(client)
    await client.ask(type="subscribe", id="s", path=LEVEL, body=RELIABLE)
    seen: list[float] = []
    for turn in range(5):
        for value in range(10):
            world.robot.host.publish("sensor/level", float(turn * 10 + value))
        last = await client.until(lambda m: m["type"] == "update" and m["body"] % 10 == 9)
        seen += [m["body"] for m in client.inbox if m["type"] == "update"] + [last["body"]]
        client.connection.close()
        for value in range(10):
            world.robot.host.publish("sensor/level", float(turn * 10 + value) + 0.5)
        client = world.client()
        await greeted(client, session=session["session"], resume_from={LEVEL: last["seq"]})
        for _ in range(10):
            seen.append((await client.update("s"))["body"])
        assert client.inbox == []
    assert sorted(seen) == sorted(
        t * 10 + v + h for t in range(5) for v in range(10) for h in (0, 0.5)
    )


async def test_what_is_not_in_the_buffer_any_more_is_told_as_a_gap(world: World) -> None:
    client = world.client()
    session = await greeted(client)
    await client.ask(type="subscribe", id="s", path=LEVEL, body=RELIABLE)
    client.connection.close()
    for value in range(500):
        world.robot.host.publish("sensor/level", float(value))
    client = world.client()
    await greeted(client, session=session["session"])
    gap = await client.notice("gap")
    first = await client.update("s")
    assert gap["path"] == LEVEL
    assert first["seq"] == gap["last"] + 1
    assert gap["lost"] + 128 == 500


async def test_a_command_that_ended_while_the_client_was_away_is_told_on_return(
    world: World,
) -> None:
    client = world.client()
    session = await greeted(client)
    client.send(type="execute", id="x", path="/action/go", body=1)
    await world.robot.started.get()
    client.connection.close()
    world.robot.release.set()
    client = world.client()
    await greeted(client, session=session["session"])
    assert (await client.final("x"))["status"] == "completed"


async def test_what_was_told_to_a_peer_that_was_gone_already_is_told_on_return(
    world: World,
) -> None:
    """As when a cable is pulled: the gateway notices by three heartbeats without an answer."""
    client = world.client()
    facts = await greeted(client)
    world.robot.release.set()
    await client.ask(type="execute", id="x", path="/action/go", body=1)
    client.connection.close()
    session = world.server.gateway.sessions.known[facts["session"]]
    assert session.cut is not None
    session.cut += int(3 * facts["heartbeat"] * 1e9)
    client = world.client()
    await greeted(client, session=facts["session"])
    assert (await client.final("x"))["status"] == "completed"


async def test_nobody_else_comes_back_to_a_session(world: World) -> None:
    client = world.client()
    session = (await greeted(client))["session"]
    client.connection.close()
    stranger = await world.client(None).ask(type="hello", body={"session": session})
    assert stranger["error"]["code"] == "unauthenticated"
    guess = await world.client().ask(
        type="hello", body={"session": session, "resume_token": "guessed"}
    )
    assert guess["error"]["code"] == "unauthenticated"


async def test_a_resume_token_brings_nobody_back_but_whose_session_it_is(world: World) -> None:
    client = world.client()
    facts = await greeted(client)
    client.connection.close()
    token = facts["resume_token"]
    for key in (None, "admin-admin-admin"):
        for body in (
            {"session": token},
            {"session": facts["session"], "resume_token": token},
            {"session": facts["session"], "token": token},
        ):
            thief = world.client(key)
            refused = await thief.ask(type="hello", body=body)
            assert refused["error"]["code"] == "unauthenticated", body
            assert thief.connection.session.id != facts["session"]
    back = await greeted(world.client(), session=token)
    assert (back["session"], back["principal"]) == (facts["session"], "operator")


async def test_who_proves_nothing_comes_back_to_a_session_begun_so(world: World) -> None:
    client = world.client(None)
    facts = await greeted(client)
    client.connection.close()
    back = await greeted(world.client(None), session=facts["resume_token"])
    assert back["session"] == facts["session"]


async def test_a_session_that_was_never_greeted_ends_with_its_connection(world: World) -> None:
    client = world.client()
    await client.ask(type="subscribe", path=LEVEL)
    client.connection.close()
    assert world.server.gateway.sessions.known == {}
    assert world.server.gateway.hub.subscriptions == set()


async def test_an_expired_session_is_a_gap(world: World) -> None:
    client = world.client()
    session = (await greeted(client))["session"]
    client.connection.close()
    world.server.gateway.sessions.drop(world.server.gateway.sessions.known[session])
    reply = await world.client().ask(type="hello", body={"session": session})
    assert reply["error"]["code"] == "gap"


async def test_changed_rules_act_on_open_sessions(world: World) -> None:
    operator, guest = world.client(), world.client(None)
    await guest.ask(type="subscribe", id="s", path=LEVEL)
    text = CONFIG.replace('key = "operator-operator"', 'key = "another-operator-key"')
    text += '\n[roles.blind]\n[anonymous]\nrole = "blind"\n'
    await apply(world.server, prepared(parse(text, "test"), []))
    expelled = await operator.until(lambda m: m.get("error", {}).get("code") == "token_expired")
    assert expelled["status"] == "rejected"
    assert (await guest.notice("resource_removed"))["path"] == LEVEL
    world.robot.host.publish("sensor/level", 1.0)
    assert (await guest.ask(type="read", path=LEVEL))["error"]["code"] == "unknown_path"
    assert not [m for m in guest.inbox if m["type"] == "update"]


async def test_what_came_before_the_subscription_is_not_replayed_after_a_cut(world: World) -> None:
    for value in range(20):
        world.robot.host.publish("sensor/level", float(value))
    client = world.client()
    session = (await greeted(client))["session"]
    await client.ask(type="subscribe", id="s", path=LEVEL, body={**RELIABLE, "initial": False})
    client.connection.close()
    world.robot.host.publish("sensor/level", 99.0)
    client = world.client()
    await greeted(client, session=session)
    assert (await client.update("s"))["body"] == 99.0
    assert client.inbox == []


async def test_a_full_gateway_lets_the_longest_absent_go_for_who_is_here() -> None:
    async with world_of("limits = {sessions = 2}\n" + CONFIG) as world:
        first, second = world.client(), world.client()
        for client in (first, second):
            await greeted(client)
            client.connection.close()
        third = await greeted(world.client())
        known = world.server.gateway.sessions.known
        assert set(known) == {second.connection.session.id, third["session"]}
        world.client()
        with pytest.raises(QueueFull):
            world.client()


async def test_two_requests_that_follow_one_command_keep_their_own_ids(world: World) -> None:
    client = world.client()
    ids = [
        client.send(type="execute", path="/action/go", body=1, idempotency_key="k")
        for _ in range(2)
    ]
    await world.robot.started.get()
    world.robot.release.set()
    finals = [await client.final(id_) for id_ in ids]
    assert finals[0]["command"] == finals[1]["command"]


async def test_a_cut_leaves_the_source_at_the_rate_that_was_wanted(world: World) -> None:
    client = world.client()
    session = (await greeted(client))["session"]
    await client.ask(type="subscribe", id="s", path="/sensor/lazy", body={"rate": 2})
    await client.update("s")
    client.connection.close()
    client = world.client()
    await greeted(client, session=session)
    await client.ask(type="ping")
    assert [rate for name, rate in world.robot.watched if name == "sensor/lazy"] == [2.0]


async def test_a_session_waits_for_its_client_as_long_as_it_is_kept_and_no_longer(
    world: World, stepped: SteppedClock
) -> None:
    ttl = world.server.gateway.settings.limits.session_ttl
    first = world.client()
    session = (await greeted(first))["session"]
    first.connection.close()
    stepped.advance(ttl / 2)
    second = world.client()
    assert (await greeted(second, session=session))["session"] == session
    second.connection.close()
    stepped.advance(ttl / 2)
    await world.client().ask(type="ping")
    assert session in world.server.gateway.sessions.known, "its time began anew"
    stepped.advance(ttl)
    await world.client().ask(type="ping")
    late = await world.client().ask(type="hello", body={"session": session})
    assert late["error"]["code"] == "gap"
