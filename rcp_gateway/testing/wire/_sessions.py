"""Sections 6 and 9 of the contract: sessions, resume, and who one is."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import Client
from rcp_gateway.testing._serve import OPERATOR
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World
from rcp_gateway.testing.wire._streams import LEVEL

__all__ = ["Sessions"]

RELIABLE = {"qos": {"reliability": "reliable", "depth": 1000}, "initial": False}


async def _hello(client: Client, /, **body: Any) -> dict[str, Any]:
    reply = await client.request("hello", body=body)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def _cut(world: World, client: Client) -> None:
    """Cut a client's connection, and wait until the gateway has noticed."""
    sessions = world.server.gateway.sessions.known
    other = await world.client()
    await client.close()
    while any(s.connection is None for s in sessions.values()) is False and len(sessions) > 1:
        await other.request("ping")
    await other.close()


class Sessions(Wire):
    """Tests of sessions and their resumption."""

    @proves("session.hello")
    async def test_hello_tells_who_one_is_and_what_holds(self, world: World) -> None:
        for encoding in self.encodings:
            facts = await _hello(await world.client(encoding=encoding), client="kit 1.0")
            assert facts.keys() >= {
                *("version", "session", "resume_token", "principal", "tenant"),
                *("heartbeat", "limits"),
            }
            assert (facts["version"], facts["principal"]) == ("1", "operator")
            assert facts["tenant"] == "alpha"
            assert facts["limits"]["message"] == 262144

    @proves("session.optional")
    async def test_hello_is_optional_and_may_come_late(self, world: World) -> None:
        client = await world.client()
        assert (await client.request("ping"))["status"] == "completed"
        id_ = await client.subscribe(LEVEL)
        await _hello(client)
        world.publish("sensor/level", 1.0)
        assert (await client.update(id_))["body"] == 1.0

    @proves("session.token")
    async def test_a_token_in_hello_changes_who_one_is(self, world: World) -> None:
        client = await world.client(None)
        wrong = await client.request("hello", body={"token": "not-a-known-key"})
        assert wrong["error"]["code"] == "unauthenticated"
        denied = await client.request("write", "/param/limit", body=1.0)
        assert denied["error"]["code"] == "forbidden"
        assert (await _hello(client, token=OPERATOR))["principal"] == "operator"
        done = await client.request("write", "/param/limit", body=1.0)
        assert done["status"] == "completed"

    @proves("session.tenant")
    async def test_hello_chooses_the_tenant(self, world: World) -> None:
        world.robot("other").host.publish("sensor/level", 8.0)
        client = await world.client()
        assert (await _hello(client, tenant="beta"))["tenant"] == "beta"
        reply = await client.request("read", "/sensor/level")
        assert (reply["path"], reply["body"]) == ("/tenant/beta/sensor/level", 8.0)
        local = await world.client(LOCAL)
        denied = await local.request("hello", body={"tenant": "beta"})
        assert denied["error"]["code"] == "forbidden"

    @proves("session.resume")
    async def test_who_comes_back_gets_what_was_missed_and_nothing_twice(
        self, world: World
    ) -> None:
        client = await world.client()
        facts = await _hello(client)
        await client.request("subscribe", LEVEL, id="s", body=RELIABLE)
        seen: list[int] = []
        for _ in range(3):
            world.publish("sensor/level", *map(float, range(5)))
            seen += [(await client.update("s"))["seq"] for _ in range(5)]
            await _cut(world, client)
            world.publish("sensor/level", *map(float, range(5)))
            client = await world.client()
            back = await _hello(client, session=facts["session"])
            assert back["session"] == facts["session"]
            seen += [(await client.update("s"))["seq"] for _ in range(5)]
        assert seen == list(range(1, 31))

    @proves("session.resume-from")
    async def test_resume_from_says_from_where(self, world: World) -> None:
        client = await world.client()
        facts = await _hello(client)
        await client.request("subscribe", LEVEL, id="s", body=RELIABLE)
        world.publish("sensor/level", *map(float, range(10)))
        for _ in range(10):
            await client.update("s")
        for have in (7, {LEVEL: 7}):
            await _cut(world, client)
            client = await world.client()
            await _hello(client, session=facts["session"], resume_from=have)
            assert [(await client.update("s"))["seq"] for _ in range(3)] == [8, 9, 10]

    @proves("session.gap")
    async def test_what_is_not_there_any_more_is_told_as_a_gap(self, world: World) -> None:
        client = await world.client()
        facts = await _hello(client)
        await client.request("subscribe", LEVEL, id="s", body=RELIABLE)
        await _cut(world, client)
        world.publish("sensor/level", *map(float, range(200)))
        client = await world.client()
        await _hello(client, session=facts["session"])
        notice = await client.notice("gap")
        assert (notice["path"], notice["first"], notice["lost"]) == (LEVEL, 1, 136)
        first = await client.update("s")
        assert first["seq"] == notice["last"] + 1 == 137

    @proves("session.command")
    async def test_a_command_that_ended_meanwhile_is_told_on_return(self, world: World) -> None:
        client = await world.client()
        facts = await _hello(client)
        body = {"distance": 2.0, "mode": "wait"}
        await client.send(type="execute", id="x", path="/action/go", body=body)
        await client.until(lambda m: m.get("status") == "in_progress")
        await _cut(world, client)
        world.robot().release.set()
        client = await world.client()
        await _hello(client, session=facts["session"])
        final = await client.final("x")
        assert (final["status"], final["body"]) == ("completed", 2.0)

    @proves("session.expired")
    async def test_a_session_that_never_was_is_a_gap(self, world: World) -> None:
        client = await world.client()
        reply = await client.request("hello", body={"session": "s-never-was"})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "gap")
        assert "subscribe again" in reply["error"]["remedy"]
        assert (await client.request("ping"))["status"] == "completed"

    @proves("session.stolen")
    async def test_nobody_else_comes_back_to_a_session(self, world: World) -> None:
        client = await world.client()
        session = (await _hello(client))["session"]
        await _cut(world, client)
        stranger = await world.client(None)
        stolen = await stranger.request("hello", body={"session": session})
        assert stolen["error"]["code"] == "unauthenticated"
        guess = await (await world.client()).request(
            "hello", body={"session": session, "resume_token": "guessed"}
        )
        assert guess["error"]["code"] == "unauthenticated"

    @proves("session.bound")
    async def test_a_resume_token_is_no_use_to_anybody_else(self, world: World) -> None:
        client = await world.client()
        facts = await _hello(client)
        await _cut(world, client)
        for token in (None, LOCAL):
            for body in (
                {"session": facts["session"], "resume_token": facts["resume_token"]},
                {"session": facts["resume_token"]},
            ):
                thief = await (await world.client(token)).request("hello", body=body)
                assert thief["error"]["code"] == "unauthenticated"
        back = await _hello(await world.client(), session=facts["resume_token"])
        assert (back["session"], back["principal"]) == (facts["session"], facts["principal"])
