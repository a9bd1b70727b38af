"""Quotas: what one tenant or principal may have, exactly, and never at another's cost."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from time import perf_counter
from typing import Any

import msgspec
import pytest

from kernel.world import BOUND, CONFIG, Client, World, prepared, world_of
from rcp_kernel.access.meter import Account, Meter
from rcp_kernel.config.file import parse
from rcp_kernel.config.limits import Quota
from rcp_kernel.errors import ConfigError, QueueFull, RateLimited
from rcp_kernel.process.reload import apply
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import Request

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"
KEYS = """
[[keys]]
name = "ann"
roles = { alpha = "operator" }
key = "ann-ann-ann-ann-ann"

[[keys]]
name = "bob"
roles = { beta = "operator" }
key = "bob-bob-bob-bob-bob"

[[keys]]
name = "agent"
roles = { alpha = "agent" }
key = "agent-agent-agent-agent"

[tenants.alpha]
[tenants.beta]
"""
SECOND = """
[[backends]]
use = "robot"
name = "second"
tenant = "beta"
"""
ANN, BOB, AGENT = "ann-ann-ann-ann-ann", "bob-bob-bob-bob-bob", "agent-agent-agent-agent"
SLOW = "[tenants.alpha.quota]\nrequests = 0.01\nburst = 3\n"


def at_home(quotas: str) -> str:
    return CONFIG + KEYS + quotas


@pytest.fixture
async def slow() -> AsyncGenerator[World]:
    """Three requests, and then no more for a long time."""
    async with world_of(at_home(SLOW)) as world:
        yield world


# -- requests --------------------------------------------------------------------------------------


async def test_what_is_over_the_rate_is_refused_and_told_when_to_come_back(slow: World) -> None:
    client = slow.client(ANN)
    replies = [await client.ask(type="ping") for _ in range(4)]
    assert [r["status"] for r in replies] == ["completed"] * 3 + ["rejected"]
    error = replies[-1]["error"]
    assert error["code"] == "rate_limited"
    assert error["retryable"]
    assert 99 < error["retry_after"] <= 100.01
    assert error["details"] == {"quota": "tenant", "what": "requests", "limit": 0.01, "burst": 3}


async def test_who_waits_as_long_as_he_is_told_is_served() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nrequests = 20\nburst = 1\n")) as world:
        client = world.client(ANN)
        assert (await client.ask(type="ping"))["status"] == "completed"
        refused = await client.ask(type="ping")
        await asyncio.sleep(refused["error"]["retry_after"])
        assert (await client.ask(type="ping"))["status"] == "completed"


async def test_a_read_that_takes_the_short_way_is_counted_like_any_other(slow: World) -> None:
    slow.robot.host.publish("sensor/level", 1.0)
    client = slow.client(ANN)
    await client.ask(type="read", path=LEVEL)  # the first read makes the path known
    replies = [await client.ask(type="read", path=LEVEL) for _ in range(3)]
    assert [r.get("error", {}).get("code") for r in replies] == [None, None, "rate_limited"]


async def test_every_item_of_a_batch_is_counted_and_the_batch_too(slow: World) -> None:
    client = slow.client(ANN)
    parts = [{"type": "ping", "id": f"p{n}"} for n in range(4)]
    reply = await client.ask(type="batch", body=parts)
    codes = [part.get("error", {}).get("code") for part in reply["body"]]
    assert codes == [None, None, "rate_limited", "rate_limited"]


async def test_what_stops_something_is_never_limited_and_costs_nothing(slow: World) -> None:
    client = slow.client(ANN)
    for _ in range(20):
        stop = await client.ask(type="execute", path="/system/estop", body={})
        assert stop["status"] == "completed"
        cancel = await client.ask(type="cancel", path="/action/go")
        assert cancel["status"] == "completed"
    replies = [await client.ask(type="ping") for _ in range(4)]
    assert [r["status"] for r in replies] == ["completed"] * 3 + ["rejected"]
    stop = await client.ask(type="execute", path="/system/estop", body={})
    assert stop["status"] == "completed"


async def test_an_actuator_is_brought_to_rest_at_any_rate_and_driven_at_the_quotas(
    slow: World,
) -> None:
    client = slow.client(ANN)
    write = {"type": "write", "path": "/actuator/drive"}
    driven = [await client.ask(**write, body={"linear": {"x": 0.1}}) for _ in range(4)]
    assert [r["status"] for r in driven] == ["completed"] * 3 + ["rejected"]
    for body in ({}, {"linear": {"x": 0.0}}):
        assert (await client.ask(**write, body=body))["status"] == "completed"
    for body in ({"linear": {"x": 0.1}}, {"linear": {"x": "fast"}}):
        assert (await client.ask(**write, body=body))["error"]["code"] == "rate_limited"
    unseen = await client.ask(type="write", path="/tenant/beta/actuator/drive", body={})
    assert unseen["error"]["code"] == "rate_limited"


async def test_a_stop_in_a_batch_over_the_rate_is_carried_out(slow: World) -> None:
    client = slow.client(ANN)
    for _ in range(3):
        await client.ask(type="ping")
    parts = [
        {"type": "ping", "id": "p"},
        {"type": "execute", "id": "s", "path": "/system/estop", "body": {}},
    ]
    reply = await client.ask(type="batch", body=parts)
    assert [part["status"] for part in reply["body"]] == ["rejected", "completed"]


@pytest.mark.parametrize("encoding", list(Encoding))
async def test_a_lease_is_let_go_of_at_any_time_and_taken_at_the_pace_of_the_quota(
    slow: World, encoding: Encoding
) -> None:
    door = slow.server.door
    session = door.session(door.authenticate(ANN))

    async def lease(do: str) -> Any:
        asked = {"do": do, "scope": "/tenant/alpha", "ttl": 5, "reason": "to release"}
        body = msgspec.Raw(dump(asked, encoding))
        request = Request(type="execute", path="/system/leases", body=body, encoding=encoding)
        return (await door.ask(session, request)).error

    assert [await lease("acquire") for _ in range(3)] == [None] * 3
    refused = await lease("acquire")
    assert (refused["code"], refused["retry_after"] > 0) == ("rate_limited", True)
    assert await lease("release") is None
    assert (await lease("renew"))["code"] == "rate_limited"


async def test_the_first_hello_is_free_so_that_whoever_has_to_stop_a_robot_gets_in(
    slow: World,
) -> None:
    flood = slow.client(ANN)
    for _ in range(10):
        await flood.ask(type="ping")
    client = slow.client(AGENT)
    assert (await client.ask(type="hello"))["status"] == "completed"
    stop = await client.ask(type="execute", path="/system/estop", body={})
    assert stop["status"] == "completed"
    again = await client.ask(type="hello")
    assert again["error"]["code"] == "rate_limited"


async def test_a_tenant_at_its_limit_slows_nobody_else() -> None:
    async with world_of(at_home(SECOND + SLOW)) as world:
        ann, bob = world.client(ANN), world.client(BOB)
        for _ in range(200):
            flood = [ann.send(type="ping") for _ in range(10)]
            reply = await bob.ask(type="read", path="/tenant/beta/param/limit")
            assert reply["status"] == "completed", reply
            for id_ in flood:
                await ann.final(id_)


async def test_all_connections_and_requests_without_one_share_their_principals_rate() -> None:
    text = at_home("[quotas.principal]\nrequests = 0.01\nburst = 3\n")
    async with world_of(text) as world:
        door = world.server.door
        one, two = world.client(ANN), world.client(ANN)
        session = door.session(door.authenticate(ANN))
        assert (await one.ask(type="ping"))["status"] == "completed"
        assert (await two.ask(type="ping"))["status"] == "completed"
        door.commands(session)
        with pytest.raises(RateLimited) as caught:
            door.schemas(session)
        assert (caught.value.details or {})["quota"] == "principal"
        other = world.client(AGENT)
        assert (await other.ask(type="ping"))["status"] == "completed"


async def test_of_several_roles_the_most_generous_counts() -> None:
    quotas = """
[quotas.principal]
requests = 2
sessions = 3
[roles.slow]
quota = { requests = 1, sessions = 9 }
[roles.fast]
quota = { requests = 5, burst = 50 }
[roles.free]
"""
    keys = "".join(
        f'[[keys]]\nname = "{n}"\nrole = {roles}\nkey = "{n * 16}"\n'
        for n, roles in (("a", ["slow", "fast"]), ("b", ["slow"]), ("c", ["slow", "free"]))
    )
    async with world_of(at_home(quotas + keys)) as world:
        found: dict[str, Any] = {}
        for name in "abc":
            meter = world.client(name * 16).connection.session.meter
            assert meter is not None
            found[name] = meter.first.quota
    assert found["a"] == Quota(requests=5, burst=50, sessions=9)
    assert found["b"] == Quota(requests=1, burst=1, sessions=9)
    assert found["c"] == Quota(requests=2, burst=2, sessions=9)


async def test_who_has_no_quota_has_no_meter(world: World) -> None:
    assert world.client().connection.session.meter is None


async def test_a_reload_changes_the_meters_that_run(slow: World) -> None:
    client = slow.client(ANN)
    for _ in range(4):
        last = await client.ask(type="ping")
    assert last["error"]["code"] == "rate_limited"
    await apply(slow.server, prepared(parse(at_home(""), "test"), []))
    assert (await client.ask(type="ping"))["status"] == "completed"
    assert client.connection.session.meter is None
    await apply(slow.server, prepared(parse(at_home(SLOW), "test"), []))
    replies = [await client.ask(type="ping") for _ in range(4)]
    assert replies[-1]["error"]["code"] == "rate_limited"


def test_pace_is_kept_over_any_span() -> None:
    meter = Meter((Account("tenant", "a", Quota(requests=10, burst=5)),))
    start = perf_counter()
    taken = sum(meter.take(start + step / 1000) for step in range(10_000))
    assert taken in (104, 105)  # the burst, and ten a second for ten seconds


# -- what is held ----------------------------------------------------------------------------------


async def test_sessions_of_a_tenant_are_counted_over_all_its_principals() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nsessions = 2\n")) as world:
        first, _second = world.client(ANN), world.client(AGENT)
        with pytest.raises(QueueFull) as caught:
            world.client(ANN)
        assert caught.value.details == {"quota": "tenant", "what": "sessions", "limit": 2}
        assert caught.value.retry_after
        assert "End sessions that are not needed" in caught.value.remedy
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
        "[tenants.beta.quota]\nsessions = 1\n"
        '[[keys]]\nname = "both"\nrole = "operator"\nkey = "both-both-both-both"\n'
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
        [account] = world.server.gateway.accounts.of("tenant")
        assert account.connected == 1
        await apply(world.server, prepared(parse(at_home(""), "test"), []))
        assert account.connected == 0


# -- what waits ------------------------------------------------------------------------------------


def stalled(client: Client) -> None:
    """Have a client take nothing any more."""
    client.connection.mailbox.on_flush = lambda: None


async def test_best_effort_gives_way_to_the_newest_when_too_much_waits() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nqueue_bytes = 2048\n")) as world:
        client = world.client(ANN)
        await client.ask(type="subscribe", id="s", path=LEVEL, body={"qos": {"depth": 1000}})
        flush = client.connection.mailbox.on_flush
        stalled(client)
        for value in range(500):
            world.robot.host.publish("sensor/level", float(value))
        mailbox = client.connection.mailbox
        assert mailbox.pending[0].waiting == 500
        await until(lambda: mailbox.pending[0].waiting == 1)
        mailbox.on_flush = flush
        mailbox.flush()
        update = await client.update("s")
        assert (update["body"], update["dropped"]) == (499.0, 499)


async def test_reliable_ends_with_overrun_when_too_much_waits() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nqueue_bytes = 2048\n")) as world:
        client = world.client(ANN)
        qos = {"qos": {"reliability": "reliable", "depth": 1000}}
        await client.ask(type="subscribe", id="s", path=LEVEL, body=qos)
        flush = client.connection.mailbox.on_flush
        stalled(client)
        for value in range(500):
            world.robot.host.publish("sensor/level", float(value))
        await until(lambda: not client.connection.session.subscriptions)
        client.connection.mailbox.on_flush = flush
        client.connection.mailbox.flush()
        told = await client.notice("overrun")
        assert "2048 bytes" in told["message"]


async def test_who_leaves_his_replies_lying_gets_no_more_and_another_goes_on() -> None:
    async with world_of(at_home("[tenants.alpha.quota]\nqueue_bytes = 2048\n")) as world:
        client, other = world.client(ANN), world.client(AGENT)
        flush = client.connection.mailbox.on_flush
        stalled(client)
        for _ in range(100):
            client.send(type="ping")
        meter = client.connection.session.meter
        assert meter is not None
        await until(lambda: meter.choked is not None)
        assert (await other.ask(type="ping"))["status"] == "completed"
        late = client.send(type="ping")
        client.connection.mailbox.on_flush = flush
        client.connection.mailbox.flush()
        refused = await client.final(late)
        assert refused["error"]["code"] == "queue_full"
        assert refused["error"]["details"]["what"] == "queue_bytes"
        await until(lambda: meter.choked is None)
        assert (await client.ask(type="ping"))["status"] == "completed"


async def until(holds: Any) -> None:
    """Wait for what the gateway's own look at its queues does."""
    async with asyncio.timeout(BOUND):
        while not holds():  # noqa: ASYNC110 - it is told to nobody
            await asyncio.sleep(0.01)


# -- for people ------------------------------------------------------------------------------------


async def test_status_shows_a_tenants_quota_to_its_own_people_only() -> None:
    text = at_home(
        "[tenants.alpha.quota]\nsessions = 5\nrequests = 1000\n[tenants.beta.quota]\ncommands = 9\n"
    )
    async with world_of(text) as world:
        ann, bob = world.client(ANN), world.client(BOB)
        await bob.ask(type="subscribe", path="/sensor/level")
        shown = (await ann.ask(type="status"))["body"]["quotas"]
        assert shown == {
            "tenants": {
                "alpha": {"sessions": {"used": 1, "limit": 5}, "requests": {"limit": 1000.0}}
            }
        }
        assert list((await bob.ask(type="status"))["body"]["quotas"]["tenants"]) == ["beta"]


async def test_a_refusal_is_the_same_whatever_another_tenant_does(slow: World) -> None:
    def told(reply: dict[str, Any]) -> Any:
        error = reply["error"]
        return error["message"], error["details"], error["remedy"]

    client = slow.client(ANN)
    for _ in range(4):
        alone = await client.ask(type="ping")
    bobs = [slow.client(BOB) for _ in range(20)]
    for bob in bobs:
        await bob.ask(type="ping")
    assert told(await client.ask(type="ping")) == told(alone)


async def test_refusals_are_counted_for_the_operator(slow: World) -> None:
    client = slow.client(ANN)
    for _ in range(5):
        await client.ask(type="ping")
    text = slow.server.door.metrics(slow.client().connection.session).decode()
    assert 'rcp_quota_refused_total{quota="tenant",tenant="alpha",what="requests"} 2.0' in text


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[tenants.alpha.quota]\nrequest = 5", ["[tenants[...].quota]", "did you mean `requests`"]),
        ("[quotas.principal]\nsessions = 0", ["quotas.principal.sessions", ">= 1"]),
        ("[roles.r.quota]\nrequests = -1", ["roles", "quota.requests"]),
        ("[quotas]\ntenant = {}", ["[quotas]", "unknown key `tenant`"]),
    ],
)
def test_a_faulty_quota_is_named(table: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(at_home(table), "gateway.toml")
    for word in words:
        assert word in str(caught.value)
