"""Who holds a lease is alone in command of its scope, until it loses it and is told why."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from configuration import key
from kernel.world import BOUND, CONFIG, Client, World, kept_in, settled, world_of
from rcp_gateway.testing import SteppedClock
from rcp_kernel.clock import Clock
from rcp_kernel.types import Twist
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request

pytestmark = pytest.mark.anyio
DRIVE = "/tenant/alpha/actuator/drive"
FORWARD = {"linear": {"x": 1.0}}
PEOPLE = key("agent", "agent-agent-agent") + key("viewer", "viewer-viewer-viewer")
AGENT, ADMIN = "agent-agent-agent", "admin-admin-admin"


@pytest.fixture
async def world(gateway_clock: Clock) -> AsyncGenerator[World]:
    async with world_of(CONFIG + PEOPLE, clock=gateway_clock) as made:
        yield made


async def lease(client: Client, do: str = "acquire", **fields: Any) -> dict[str, Any]:
    fields.setdefault("scope", "/tenant/alpha")
    return await client.ask(type="execute", path="/system/leases", body={"do": do, **fields})


async def drive(client: Client, **fields: Any) -> dict[str, Any]:
    return await client.ask(type="write", path=DRIVE, body=FORWARD, **fields)


def code(reply: dict[str, Any]) -> str:
    return reply.get("error", {}).get("code", reply["status"])


async def greet(client: Client) -> dict[str, Any]:
    client.send(type="hello", id="hello")
    return (await client.final("hello"))["body"]


async def test_a_lease_keeps_others_from_commanding_and_from_nothing_else(world: World) -> None:
    holder, other = world.client(), world.client(ADMIN)
    held = (await lease(holder, ttl=5, reason="mapping"))["body"]
    assert (held["scope"], held["holder"], held["priority"]) == ("/tenant/alpha", "operator", 50)
    assert held["reason"] == "mapping"
    refused = await drive(other)
    assert code(refused) == "lease_held"
    assert refused["error"]["details"]["holder"] == "operator"
    assert 0 < refused["error"]["retry_after"] <= 5
    assert code(await other.ask(type="execute", path="/action/go", body=1)) == "lease_held"
    assert code(await drive(other, dry_run=True)) == "lease_held"
    assert code(await drive(holder)) == "completed"
    assert code(await other.ask(type="read", path=DRIVE)) == "completed"
    running = holder.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    assert code(await other.ask(type="cancel", path="/action/go")) == "completed"
    assert (await holder.final(running))["status"] == "cancelled"
    assert code(await other.ask(type="execute", path="/system/estop", body={})) == "completed"


async def test_a_released_lease_leaves_running_what_runs(world: World) -> None:
    holder, other = world.client(), world.client()
    await lease(holder)
    running = holder.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    assert code(await lease(holder, "release")) == "completed"
    assert code(await drive(other)) == "completed"
    assert code(await drive(holder)) == "completed"
    world.robot.release.set()
    assert (await holder.final(running))["status"] == "completed"


async def test_a_person_takes_over_from_an_agent_that_is_told_why(world: World) -> None:
    agent, person = world.client(AGENT), world.client()
    await lease(agent)
    running = agent.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    assert code(await drive(agent, valid_for=100)) == "completed"
    assert code(await lease(person)) == "lease_held"
    assert code(await lease(person, take=True)) == "bad_request"
    taken = await lease(person, take=True, reason="a child is in the way")
    assert code(taken) == "completed"
    told = await agent.notice("lease_lost")
    assert (told["by"], told["reason"]) == ("operator", "a child is in the way")
    ended = await agent.final(running)
    assert ended["status"] == "cancelled"
    assert "a child is in the way" in ended["message"]
    lost = await drive(agent)
    assert code(lost) == "lease_lost"
    assert lost["error"]["details"]["by"] == "operator"
    assert "a child is in the way" in lost["message"]
    assert code(await lease(agent, take=True, reason="mine")) == "lease_held"
    assert code(await drive(person)) == "completed"
    values = [value for _, value in world.robot.writes]
    assert values[0].linear.x == 1.0
    assert Twist() in values[1:]


async def test_an_equal_priority_waits(world: World) -> None:
    one, two = world.client(), world.client()
    await lease(one)
    assert code(await lease(two, take=True, reason="my turn")) == "lease_held"
    await lease(one, "release")
    assert code(await lease(two)) == "completed"


async def test_a_lapsed_lease_brings_to_rest_what_its_holder_left_moving(
    world: World, stepped: SteppedClock
) -> None:
    holder = world.client()
    await lease(holder, ttl=300)
    await drive(holder, valid_for=1000)
    stepped.advance(200)
    assert code(await drive(world.client("admin-admin-admin"))) == "lease_held"
    stepped.advance(200)
    told = await holder.notice("lease_lost")
    assert "expired" in told["reason"]
    id_ = holder.send(type="subscribe", path=DRIVE)
    await holder.until(
        lambda m: m["type"] == "update" and m["id"] == id_ and m["body"]["linear"]["x"] == 0
    )
    assert world.robot.writes[-1] == ("actuator/drive", Twist())
    assert code(await drive(holder)) == "lease_lost"
    assert code(await lease(holder, "renew")) == "lease_lost"
    assert code(await lease(holder)) == "completed"
    assert code(await drive(holder)) == "completed"


async def test_who_gives_up_a_lost_lease_goes_on_without(
    world: World, stepped: SteppedClock
) -> None:
    holder = world.client()
    await lease(holder, ttl=300)
    stepped.advance(400)
    await holder.notice("lease_lost")
    assert code(await drive(holder)) == "lease_lost"
    assert code(await lease(holder, "release")) == "lease_lost"
    assert code(await drive(holder)) == "completed"


async def test_a_renewed_lease_stands(world: World, stepped: SteppedClock) -> None:
    holder = world.client()
    first = (await lease(holder, ttl=200))["body"]
    stepped.advance(100)
    again = (await lease(holder, "renew", ttl=300))["body"]
    stepped.advance(200)
    assert again["lease"] == first["lease"]
    assert again["expires"] > first["expires"]
    named = await holder.ask(
        type="execute", path="/system/leases", body={"do": "renew", "lease": first["lease"]}
    )
    assert code(named) == "completed"
    assert code(await lease(holder, ttl=1000)) == "out_of_range"
    assert code(await lease(world.client(), "renew")) == "lease_required"


async def test_no_write_of_the_loser_comes_after_the_winners_first(world: World) -> None:
    agent, person = world.client(AGENT), world.client()
    await lease(agent)
    log: list[tuple[str, float]] = []
    hold = asyncio.Event()
    entered = asyncio.Event()

    async def write(_name: str, value: Any) -> None:
        x = value.linear.x
        log.append(("begin", x))
        try:
            if x == 1.0:
                entered.set()
                await hold.wait()
        except asyncio.CancelledError:
            for _ in range(20):  # a device that takes its time to let go
                await asyncio.sleep(0)
            raise
        finally:
            log.append(("end", x))

    world.robot.write = write
    first = agent.send(type="write", path=DRIVE, body=FORWARD)
    async with asyncio.timeout(BOUND):
        await entered.wait()
    queued = [agent.send(type="write", path=DRIVE, body=FORWARD) for _ in range(5)]
    took = person.send(
        type="execute",
        path="/system/leases",
        body={"do": "acquire", "scope": "/tenant/alpha", "take": True, "reason": "danger"},
    )
    mine = person.send(type="write", path=DRIVE, body={"linear": {"x": 0.5}})
    assert code(await person.final(took)) == "completed"
    assert code(await person.final(mine)) == "completed"
    assert [code(await agent.final(id_)) for id_ in (first, *queued)] == ["lease_lost"] * 6
    assert [x for what, x in log if what == "begin"].count(1.0) == 1
    assert log.index(("end", 1.0)) < log.index(("begin", 0.5))
    assert ("begin", 1.0) not in log[log.index(("begin", 0.5)) :]


async def test_a_command_that_waits_is_refused_when_its_lease_is_lost(world: World) -> None:
    agent, person = world.client(AGENT), world.client()
    await lease(agent)
    agent.send(type="execute", path="/action/wait_in_line", body=1)
    await world.robot.started.get()
    waiting = agent.send(type="execute", path="/action/wait_in_line", body=2)
    await lease(person, take=True, reason="danger")
    ended = await agent.final(waiting)
    assert (ended["status"], code(ended)) == ("rejected", "lease_lost")
    assert world.robot.started.empty()


async def test_a_command_that_waited_through_an_acquire_is_refused_at_its_turn(
    world: World,
) -> None:
    one, two = world.client(), world.client()
    running = one.send(type="execute", path="/action/wait_in_line", body=1)
    await world.robot.started.get()
    waiting = one.send(type="execute", path="/action/wait_in_line", body=2)
    await lease(two)
    world.robot.release.set()
    assert (await one.final(running))["status"] == "completed"
    assert code(await one.final(waiting)) == "lease_held"


async def test_leases_are_checked_whenever_there_is_one_and_only_then(world: World) -> None:
    holder, other = world.client(), world.client(ADMIN)
    for _ in range(2):  # the guard is idle in between
        assert code(await drive(other)) == "completed"
        held = (await lease(holder))["body"]
        assert code(await drive(other)) == "lease_held"
        await lease(holder, "release", scope=held["scope"])
    assert code(await drive(other)) == "completed"


async def test_a_lease_is_handed_over_with_its_commands(world: World) -> None:
    agent, person = world.client(AGENT), world.client()
    await lease(agent)
    running = agent.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    given = (await lease(agent, "hand_over", to="operator"))["body"]
    assert (given["holder"], given["priority"]) == ("operator", 50)
    assert (await agent.notice("lease_given"))["to"] == "operator"
    assert (await person.notice("lease_given"))["by"] == "agent"
    assert code(await drive(agent)) == "lease_held"
    assert code(await drive(person)) == "completed"
    await world.client(ADMIN).ask(
        type="execute",
        path="/system/leases",
        body={"do": "acquire", "scope": "/tenant/alpha", "take": True, "reason": "audit"},
    )
    ended = await agent.final(running)
    assert ended["status"] == "cancelled"
    assert "audit" in ended["message"]


async def test_a_lease_is_handed_only_to_who_may_command_there(world: World) -> None:
    agent, viewer = world.client(AGENT), world.client("viewer-viewer-viewer")
    await lease(agent)
    assert code(await lease(agent, "hand_over", to="viewer")) == "unknown_path"
    assert code(await lease(agent, "hand_over")) == "bad_request"
    one, two = world.client(), world.client()
    assert code(await lease(agent, "hand_over", to="operator")) == "bad_request"
    to = two.connection.session.id[:8]
    assert code(await lease(agent, "hand_over", to=to)) == "completed"
    assert code(await drive(one)) == "lease_held"
    assert code(await drive(two)) == "completed"
    assert code(await viewer.ask(type="read", path=DRIVE)) == "completed"


async def test_only_what_can_be_commanded_can_be_leased(world: World) -> None:
    client, viewer = world.client(), world.client("viewer-viewer-viewer")
    assert code(await lease(client, scope="/sensor")) == "forbidden"
    assert code(await lease(client, scope="/tenant/beta")) == "unknown_path"
    assert code(await lease(client, scope="/system/status")) == "invalid_path"
    assert code(await lease(viewer)) == "unknown_path"
    assert code(await lease(client, scope="/actuator")) == "completed"


async def test_a_path_that_requires_a_lease_is_refused_to_who_holds_none() -> None:
    text = CONFIG + '[safety]\nlease_required = ["/actuator/**"]\n'
    async with world_of(text) as world:
        client = world.client()
        assert code(await drive(client)) == "lease_required"
        assert code(await client.ask(type="write", path="/param/limit", body=1)) == "completed"
        await lease(client, scope="/actuator")
        assert code(await drive(client)) == "completed"
        await lease(client, "release", scope="/actuator")
        assert code(await drive(client)) == "lease_required"


async def test_a_lease_survives_a_cut_and_its_holder_is_told_of_the_loss_on_return(
    world: World,
) -> None:
    agent, person = world.client(AGENT), world.client()
    known = await greet(agent)
    await lease(agent)
    agent.connection.close()
    assert code(await drive(person)) == "lease_held"
    back = world.client(AGENT)
    back.send(
        type="hello",
        id="back",
        body={"session": known["session"], "resume_token": known["resume_token"]},
    )
    await back.final("back")
    assert code(await drive(back)) == "completed"
    back.connection.close()
    await lease(person, take=True, reason="while you were away")
    again = world.client(AGENT)
    again.send(
        type="hello",
        id="back",
        body={"session": known["session"], "resume_token": known["resume_token"]},
    )
    await again.final("back")
    assert (await again.notice("lease_lost"))["reason"] == "while you were away"


async def test_a_lease_ends_with_its_session(world: World) -> None:
    holder, other = world.client(), world.client()
    await lease(holder)
    await drive(holder, valid_for=100)
    holder.connection.close()  # its client never said hello, so it cannot come back
    assert code(await drive(other)) == "completed"


async def test_what_a_request_without_a_session_acquires_is_its_principals(world: World) -> None:
    client_api = world.server.client_api
    http = client_api.session(client_api.authenticate("operator-operator"))
    body = b'{"do":"acquire","scope":"/tenant/alpha"}'
    request = Request(type="execute", path="/system/leases", encoding=Encoding.JSON)
    request.body = type(request.body)(body)
    held = await client_api.request(http, request)
    assert held.status == "completed"
    assert held.body.session is None
    assert code(await drive(world.client(ADMIN))) == "lease_held"
    mine = world.client()
    assert code(await drive(mine)) == "completed"
    again = client_api.renamed("other").session(client_api.authenticate("operator-operator"))
    write = Request(type="write", path=DRIVE, encoding=Encoding.JSON)
    write.body = type(write.body)(b'{"linear":{"x":1.0}}')
    assert (await client_api.request(again, write)).status == "completed"
    assert code(await lease(mine, "release")) == "completed"
    assert code(await lease(mine)) == "completed"
    assert (await client_api.request(again, write)).status == "rejected"


async def test_who_looks_sees_the_leases_of_robots_that_it_sees(world: World) -> None:
    holder, other = world.client(), world.client(ADMIN)
    id_ = other.send(type="subscribe", path="/system/leases")
    assert (await other.update(id_))["body"] == []
    held = (await lease(holder))["body"]
    assert (await other.update(id_))["body"] == [held]
    assert (await other.ask(type="read", path="/system/leases"))["body"] == [held]
    await lease(holder, "release")
    assert (await other.update(id_))["body"] == []


async def test_an_estop_ends_the_leases_on_what_it_stops(world: World) -> None:
    holder, admin = world.client(), world.client(ADMIN)
    await lease(holder)
    await admin.ask(type="execute", path="/system/estop", body={"reason": "smoke"})
    assert "smoke" in (await holder.notice("lease_lost"))["reason"]
    assert code(await drive(holder)) == "estop_active"
    await admin.ask(type="execute", path="/system/estop", body={"reset": True})
    assert code(await drive(holder)) == "lease_lost"
    assert code(await lease(holder)) == "completed"
    assert code(await drive(holder)) == "completed"


async def test_a_lease_outlives_the_gateway_that_gave_it(tmp_path: Path) -> None:
    text = kept_in(tmp_path / "rcp.db", CONFIG + PEOPLE)
    async with world_of(text) as world:
        client_api = world.server.client_api
        http = client_api.session(client_api.authenticate("operator-operator"))
        request = Request(type="execute", path="/system/leases", encoding=Encoding.JSON)
        request.body = type(request.body)(b'{"do":"acquire","scope":"/tenant/alpha","ttl":100}')
        before = (await client_api.request(http, request)).body
        await settled(world.server.gateway.store)
    async with world_of(text) as world:
        client = world.client(ADMIN)
        assert code(await drive(client)) == "lease_held"
        listed = (await client.ask(type="read", path="/system/leases"))["body"]
        assert [one["lease"] for one in listed] == [before.lease]
        assert listed[0]["expires"] == before.expires


async def test_a_lease_does_not_outlast_a_clock_that_was_set_back_over_a_restart(
    stepped: SteppedClock, tmp_path: Path
) -> None:
    text = kept_in(tmp_path / "rcp.db", CONFIG + PEOPLE)
    async with world_of(text, clock=stepped.clock) as world:
        await lease(world.client(AGENT), "acquire", scope="/tenant/alpha")
        await settled(world.server.gateway.store)
    stepped.adjust(-7 * 86_400)
    async with world_of(text, clock=stepped.clock) as world:
        other = world.client()
        reply = await other.ask(type="write", path="/param/limit", body=1.0)
        assert reply["error"]["code"] == "lease_held"
        stepped.advance(4_000)
        reply = await other.ask(type="write", path="/param/limit", body=1.0)
        assert reply["status"] == "completed", reply


async def test_nor_does_it_get_the_longest_time_again_at_every_restart(
    stepped: SteppedClock, tmp_path: Path
) -> None:
    text = kept_in(tmp_path / "rcp.db", CONFIG + PEOPLE)
    async with world_of(text, clock=stepped.clock) as world:
        await lease(world.client(AGENT), "acquire", scope="/tenant/alpha")
        await settled(world.server.gateway.store)
    stepped.adjust(-7 * 86_400)
    for _ in range(2):
        async with world_of(text, clock=stepped.clock) as world:
            await settled(world.server.gateway.store)
            stepped.advance(200)  # of `lease_ttl_max`, 300
    async with world_of(text, clock=stepped.clock) as world:
        reply = await world.client().ask(type="write", path="/param/limit", body=1.0)
        assert reply["status"] == "completed", reply


async def test_a_repeated_request_for_a_lease_does_nothing_again(world: World) -> None:
    holder = world.client()
    ask = {"type": "execute", "path": "/system/leases", "idempotency_key": "once"}
    ask["body"] = {"do": "acquire", "scope": "/tenant/alpha"}
    first = await holder.ask(**ask)
    await lease(holder, "release")
    again = await holder.ask(**ask)
    assert again["body"] == first["body"]
    assert (await holder.ask(type="read", path="/system/leases"))["body"] == []
