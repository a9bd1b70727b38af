"""A client comes back to its session although the gateway was killed and started anew."""

from __future__ import annotations

import shutil
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from kernel.world import CONFIG, Client, World, kept_in, settled, world_of
from rcp_gateway.testing import SteppedClock

pytestmark = pytest.mark.anyio
GO = "/tenant/alpha/action/go"


@asynccontextmanager
async def killed(tmp_path: Path, config: str = CONFIG) -> AsyncGenerator[tuple[Client, World]]:
    """Give a greeted client, whose gateway is then killed: `crashed.db` is what that leaves."""
    async with world_of(kept_in(tmp_path / "run.db", config)) as world:
        client = world.client()
        yield client, world
        await settled(world.server.gateway.store)
        for suffix in (".head", "", "-wal"):
            shutil.copy(tmp_path / f"run.db{suffix}", tmp_path / f"crashed.db{suffix}")


def after(tmp_path: Path, config: str = CONFIG) -> Any:
    return world_of(kept_in(tmp_path / "crashed.db", config))


async def greeting(client: Client, **body: Any) -> dict[str, Any]:
    return (await client.ask(type="hello", body=body))["body"]


def returning(hello: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"session": hello["session"], "resume_token": hello["resume_token"], **more}


async def test_subscriptions_go_on_with_a_notice_of_the_gap(tmp_path: Path) -> None:
    async with killed(tmp_path) as (client, world):
        hello = await greeting(client)
        options = {"rate": 50, "history": 5}
        await client.ask(type="subscribe", path="/sensor/level", id="level", body=options)
        await client.ask(type="subscribe", path="/tenant/*/param/*", id="params")
        await client.ask(type="subscribe", path="/sensor/level", id="over")
        await client.ask(type="unsubscribe", id="over")
        await client.ask(type="subscribe", path="/sensor/level", id="two", body={"count": 2})
        for level in range(5):
            world.robot.host.publish("sensor/level", float(level))
    async with after(tmp_path) as world:
        client = world.client()
        again = await greeting(client, **returning(hello, resume_from=5))
        assert (again["session"], again["principal"]) == (hello["session"], "operator")
        assert again["resume_token"] == hello["resume_token"]
        for id_ in ("level", "params"):
            gap = await client.notice("gap")
            assert (gap["id"], gap["reason"]) == (id_, "restart")
        world.robot.host.publish("sensor/level", 7.0)
        update = await client.update("level")
        assert (update["seq"], update["body"]) == (1, 7.0)
        await client.ask(type="write", path="/param/limit", body=1.25)
        assert (await client.update("params"))["body"] == 1.25
        assert sorted(client.connection.session.subscriptions) == ["level", "params"]


async def test_a_command_that_the_crash_cut_off_is_told_of(tmp_path: Path) -> None:
    async with killed(tmp_path) as (client, world):
        hello = await greeting(client)
        client.send(type="execute", path=GO, body=1, id="go")
        await world.robot.started.get()
    async with after(tmp_path) as world:
        client = world.client()
        await greeting(client, **returning(hello))
        reply = await client.final("go")
        assert reply["status"] == "failed"
        assert "stopped while" in reply["error"]["message"]


async def test_nobody_else_gets_the_session_and_a_try_does_not_end_it(tmp_path: Path) -> None:
    async with killed(tmp_path) as (client, _):
        hello = await greeting(client)
    async with after(tmp_path) as world:
        wrong = returning(hello) | {"resume_token": "x" * 32}
        for token in ("operator-operator", "admin-admin-admin"):
            refused = await world.client(token).ask(type="hello", body=wrong)
            assert refused["error"]["code"] == "unauthenticated"
        stranger = await world.client("admin-admin-admin").ask(
            type="hello", body={"session": hello["session"]}
        )
        assert stranger["error"]["code"] == "unauthenticated"
        for token in (None, "admin-admin-admin"):
            stolen = await world.client(token).ask(type="hello", body=returning(hello))
            assert stolen["error"]["code"] == "unauthenticated"
        again = await greeting(world.client(), session=hello["session"])  # the same key will do
        assert again["session"] == hello["session"]
        assert again["resume_token"] != hello["resume_token"]


async def test_whose_key_was_taken_away_does_not_come_back(tmp_path: Path) -> None:
    async with killed(tmp_path) as (client, _):
        hello = await greeting(client)
    async with after(tmp_path, CONFIG.replace("operator-operator", "another-operator")) as world:
        reply = await world.client(None).ask(type="hello", body=returning(hello))
        assert reply["error"]["code"] == "unauthenticated"


async def test_a_session_is_kept_no_longer_than_its_time(tmp_path: Path) -> None:
    short = CONFIG + "[limits]\nsession_ttl = 0\n"
    async with killed(tmp_path) as (client, _):
        hello = await greeting(client)
    async with after(tmp_path, short) as world:
        reply = await world.client().ask(type="hello", body=returning(hello))
        assert reply["error"]["code"] == "gap"
        await settled(world.server.gateway.store)
        assert world.server.gateway.store.load("sessions") == {}


@pytest.mark.parametrize("back", [0, -7 * 86_400])
async def test_a_session_does_not_get_its_time_again_at_every_restart(
    stepped: SteppedClock, tmp_path: Path, back: float
) -> None:
    text = kept_in(tmp_path / "run.db", CONFIG + "[limits]\nsession_ttl = 300\n")
    async with world_of(text, clock=stepped.clock) as world:
        hello = await greeting(world.client())
    stepped.adjust(back)
    for _ in range(2):
        async with world_of(text, clock=stepped.clock):
            stepped.advance(200)
    async with world_of(text, clock=stepped.clock) as world:
        reply = await world.client().ask(type="hello", body=returning(hello))
        assert reply["error"]["code"] == "gap"


async def test_a_gateway_that_was_stopped_keeps_its_sessions_too(tmp_path: Path) -> None:
    async with world_of(kept_in(tmp_path / "run.db")) as world:
        client = world.client()
        hello = await greeting(client)
        await client.ask(type="subscribe", path="/sensor/level", id="level")
        gone = world.client()
        left = await greeting(gone)
        world.server.gateway.sessions.drop(gone.connection.session)
    async with world_of(kept_in(tmp_path / "run.db")) as world:
        client = world.client()
        assert (await greeting(client, **returning(hello)))["session"] == hello["session"]
        assert (await client.notice("gap"))["id"] == "level"
        reply = await world.client().ask(type="hello", body=returning(left))
        assert reply["error"]["code"] == "gap"


async def test_neither_ids_nor_tokens_of_sessions_are_on_the_disk(tmp_path: Path) -> None:
    async with killed(tmp_path) as (client, _):
        hello = await greeting(client)
        await client.ask(type="execute", path="/tenant/alpha/service/echo", body="x")
    for suffix in (".head", "", "-wal"):
        held = (tmp_path / f"crashed.db{suffix}").read_bytes()
        for secret in (hello["session"], hello["resume_token"], "operator-operator"):
            assert secret.encode() not in held


async def test_the_leases_of_a_session_are_its_own_again(tmp_path: Path) -> None:
    async with killed(tmp_path) as (client, _):
        hello = await greeting(client)
        scope = {"do": "acquire", "scope": "/tenant/alpha", "ttl": 30}
        taken = await client.ask(type="execute", path="/system/leases", body=scope)
        assert taken["status"] == "completed", taken
    write = {"type": "write", "path": "/tenant/alpha/param/limit", "body": 1.0}
    async with after(tmp_path) as world:
        refused = await world.client().ask(**write)
        assert refused["error"]["code"] == "lease_held"
        client = world.client()
        await greeting(client, **returning(hello))
        assert (await client.ask(**write))["status"] == "completed"
