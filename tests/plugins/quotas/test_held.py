"""How many sessions, subscriptions and commands one may hold, and how much may wait for one."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from configuration import key, table
from kernel.world import BOUND, Client, prepared, world_of
from plugins.quotas.home import AGENT, ANN, BOB, LEVEL, at_home, usages_of
from rcp_gateway.reload import apply
from rcp_kernel.config.file import parse
from rcp_kernel.errors import QueueFull

pytestmark = pytest.mark.anyio


async def test_sessions_of_a_tenant_are_counted_over_all_its_principals() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nsessions = 2\n")) as world:
        first, _second = world.client(ANN), world.client(AGENT)
        with pytest.raises(QueueFull) as caught:
            world.client(ANN)
        assert caught.value.details == {"quota": "tenant", "what": "sessions", "limit": 2}
        assert caught.value.retry_after
        assert "End sessions that you no longer need" in caught.value.remedy
        for _ in range(5):
            world.client(BOB)
        first.connection.close()
        world.client(ANN)


async def test_at_the_limit_a_client_can_still_come_back_to_its_session() -> None:
    async with world_of(at_home("[quotas.principal]\nsessions = 1\n")) as world:
        client = world.client(ANN)
        known = (await client.ask(type="hello"))["body"]
        for _ in range(3):
            client.connection.close()
            client = world.client(ANN)
            back = await client.ask(type="hello", body={"session": known["session"]})
            assert back["body"]["session"] == known["session"]
        with pytest.raises(QueueFull):
            world.client(ANN)


async def test_a_tenant_with_all_its_sessions_is_not_entered_by_hello_either() -> None:
    text = at_home(
        table("tenants.beta.quota", sessions=1)
        + key("both", "both-both-both-both", role="operator")
    )
    async with world_of(text) as world:
        world.client(BOB)
        client = world.client("both-both-both-both")
        reply = await client.ask(type="hello", body={"tenant": "beta"})
        assert reply["error"]["code"] == "queue_full"
        assert (await client.ask(type="hello"))["body"]["tenant"] == "alpha"


async def test_subscriptions_are_given_back_however_they_end() -> None:
    async with world_of(at_home("[quotas.principal]\nsubscriptions = 2\n")) as world:
        one, two = world.client(ANN), world.client(ANN)

        async def full() -> None:
            refused = await two.ask(type="subscribe", path=LEVEL)
            assert refused["error"]["code"] == "queue_full", refused
            assert refused["error"]["details"]["what"] == "subscriptions"
            assert refused["error"]["retry_after"]
            assert refused["error"]["remedy"]

        await one.ask(type="subscribe", id="a", path=LEVEL)
        await two.ask(type="subscribe", id="b", path=LEVEL, body={"count": 1})
        await full()
        world.robot.host.publish("sensor/level", 1.0)
        await two.notice("subscription_ended")
        await two.ask(type="subscribe", id="c", path=LEVEL)
        await full()
        await one.ask(type="unsubscribe", id="a")
        await two.ask(type="subscribe", id="d", path=LEVEL)
        await full()
        await two.ask(type="unsubscribe", id="d")
        await one.ask(type="subscribe", id="e", path=LEVEL)
        one.connection.close()
        reply = await two.ask(type="subscribe", id="f", path=LEVEL)
        assert reply["status"] == "completed", reply


async def test_commands_are_counted_until_they_end() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\ncommands = 1\n")) as world:
        client, other = world.client(ANN), world.client(AGENT)
        running = client.send(type="execute", path="/action/go", body=1)
        await client.until(lambda m: m.get("status") == "in_progress")
        refused = await other.ask(type="execute", path="/action/cut_in", body=1)
        assert refused["error"]["code"] == "queue_full"
        assert refused["error"]["retry_after"]
        assert refused["error"]["remedy"]
        stop = await other.ask(type="execute", path="/system/estop", body={})
        assert stop["status"] == "completed"
        assert (await client.final(running))["status"] != "completed"
        echo = await other.ask(type="execute", path="/service/echo", body="x")
        assert echo["status"] == "completed", echo


async def test_commands_that_run_are_counted_under_the_quota_that_a_reload_brings() -> None:
    async with world_of(at_home("")) as world:
        client = world.client(ANN)
        client.send(type="execute", path="/action/go", body=1)
        await client.until(lambda m: m.get("status") == "in_progress")
        text = at_home("[tenants.alpha.quota]\ncommands = 1\n")
        await apply(world.server, prepared(parse(text, "test"), []))
        refused = await client.ask(type="execute", path="/service/echo", body="x")
        assert refused["error"]["code"] == "queue_full"


async def test_a_session_whose_command_runs_is_given_back_when_its_quota_goes() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nsessions = 4\n")) as world:
        client = world.client(ANN)
        client.send(type="execute", path="/action/go", body=1)
        await client.until(lambda m: m.get("status") == "in_progress")
        [usage] = usages_of(client.connection.session)
        assert usage.connected == 1
        await apply(world.server, prepared(parse(at_home(""), "test"), []))
        assert usage.connected == 0


def stalled(client: Client) -> None:
    """Have a client take nothing any more."""
    client.connection.outbox.on_flush = lambda: None


async def test_best_effort_gives_way_to_the_newest_when_too_much_waits() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nqueue_bytes = 2048\n")) as world:
        client = world.client(ANN)
        await client.ask(type="subscribe", id="s", path=LEVEL, body={"qos": {"depth": 1000}})
        flush = client.connection.outbox.on_flush
        stalled(client)
        for value in range(500):
            world.robot.host.publish("sensor/level", float(value))
        outbox = client.connection.outbox
        assert outbox.pending[0].waiting == 500
        await until(lambda: outbox.pending[0].waiting == 1)
        outbox.on_flush = flush
        outbox.flush()
        update = await client.update("s")
        assert (update["body"], update["dropped"]) == (499.0, 499)


async def test_reliable_ends_with_overrun_when_too_much_waits() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nqueue_bytes = 2048\n")) as world:
        client = world.client(ANN)
        qos = {"qos": {"reliability": "reliable", "depth": 1000}}
        await client.ask(type="subscribe", id="s", path=LEVEL, body=qos)
        flush = client.connection.outbox.on_flush
        stalled(client)
        for value in range(500):
            world.robot.host.publish("sensor/level", float(value))
        await until(lambda: not client.connection.session.subscriptions)
        client.connection.outbox.on_flush = flush
        client.connection.outbox.flush()
        notice = await client.notice("overrun")
        assert "2048 unread bytes" in notice["message"]


async def test_who_leaves_his_replies_lying_gets_no_more_and_another_goes_on() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nqueue_bytes = 2048\n")) as world:
        client, other = world.client(ANN), world.client(AGENT)
        flush = client.connection.outbox.on_flush
        stalled(client)
        for _ in range(100):
            client.send(type="ping")
        account: Any = client.connection.session.account
        await until(lambda: account.choked is not None)
        assert (await other.ask(type="ping"))["status"] == "completed"
        late = client.send(type="ping")
        client.connection.outbox.on_flush = flush
        client.connection.outbox.flush()
        refused = await client.final(late)
        assert refused["error"]["code"] == "queue_full"
        assert refused["error"]["details"]["what"] == "queue_bytes"
        await until(lambda: account.choked is None)
        assert (await client.ask(type="ping"))["status"] == "completed"


async def until(holds: Any) -> None:
    """Wait for what the gateway's own look at its queues does."""
    async with asyncio.timeout(BOUND):
        while not holds():  # noqa: ASYNC110 - it is told to nobody
            await asyncio.sleep(0.01)
