"""The rate of requests that one tenant or principal may have, exactly, and never at another's cost."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import msgspec
import pytest

from configuration import key
from kernel.world import World, prepared, world_of
from plugins.quotas.home import AGENT, ANN, BOB, LEVEL, SECOND, SLOW, at_home, usages_of
from rcp_gateway.reload import apply
from rcp_gateway.testing import SteppedClock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import RateLimited
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import Request
from rcp_quotas import Quota
from rcp_quotas.bucket import TokenBucket
from rcp_quotas.usage import QuotaUsage
from steps import finished

pytestmark = pytest.mark.anyio


async def test_what_is_over_the_rate_is_refused_and_told_when_to_come_back(slow: World) -> None:
    client = slow.client(ANN)
    replies = [await client.ask(type="ping") for _ in range(4)]
    assert [r["status"] for r in replies] == ["completed"] * 3 + ["rejected"]
    error = replies[-1]["error"]
    assert error["code"] == "rate_limited"
    assert error["retryable"]
    assert 99 < error["retry_after"] <= 100.01
    assert error["details"] == {"quota": "tenant", "what": "requests", "limit": 0.01, "burst": 3}


async def test_who_waits_as_long_as_he_is_told_is_served(stepped: SteppedClock) -> None:
    text = at_home("[tenants.alpha.quota]\nrequests = 0.01\nburst = 1\n")
    async with world_of(text, clock=stepped.clock) as world:
        client = world.client(ANN)
        assert (await client.ask(type="ping"))["status"] == "completed"
        refused = await client.ask(type="ping")
        stepped.advance(refused["error"]["retry_after"] / 2)
        assert (await client.ask(type="ping"))["status"] == "rejected"
        stepped.advance(refused["error"]["retry_after"] / 2)
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
    client_api = slow.server.client_api
    session = client_api.session(client_api.authenticate(ANN))

    async def lease(do: str) -> Any:
        asked = {"do": do, "scope": "/tenant/alpha", "ttl": 5, "reason": "to release"}
        body = msgspec.Raw(dump(asked, encoding))
        request = Request(type="execute", path="/system/leases", body=body, encoding=encoding)
        return (await client_api.request(session, request)).error

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
        client_api = world.server.client_api
        one, two = world.client(ANN), world.client(ANN)
        session = client_api.session(client_api.authenticate(ANN))
        assert (await one.ask(type="ping"))["status"] == "completed"
        assert (await two.ask(type="ping"))["status"] == "completed"
        client_api.commands(session)
        with pytest.raises(RateLimited) as caught:
            client_api.schemas(session)
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
        key(n, n * 16, role=roles)
        for n, roles in (("a", ["slow", "fast"]), ("b", ["slow"]), ("c", ["slow", "free"]))
    )
    async with world_of(at_home(quotas + keys)) as world:
        found: dict[str, Any] = {}
        for name in "abc":
            [usage] = usages_of(world.client(name * 16).connection.session)
            found[name] = usage.quota
    assert found["a"] == Quota(requests=5, burst=50, sessions=9)
    assert found["b"] == Quota(requests=1, burst=1, sessions=9)
    assert found["c"] == Quota(requests=2, burst=2, sessions=9)


async def test_who_has_no_quota_has_no_account(slow: World) -> None:
    assert slow.client(ANN).connection.session.account is not None
    assert slow.client(BOB).connection.session.account is None


async def test_a_reload_changes_the_rates_that_run(slow: World) -> None:
    client = slow.client(ANN)
    for _ in range(4):
        last = await client.ask(type="ping")
    assert last["error"]["code"] == "rate_limited"
    await apply(slow.server, prepared(parse(at_home(""), "test"), []))
    assert (await client.ask(type="ping"))["status"] == "completed"
    assert client.connection.session.account is None
    await apply(slow.server, prepared(parse(at_home(SLOW), "test"), []))
    replies = [await client.ask(type="ping") for _ in range(4)]
    assert replies[-1]["error"]["code"] == "rate_limited"


def test_pace_is_kept_over_any_span() -> None:
    bucket = TokenBucket((QuotaUsage("tenant", "a", Quota(requests=10, burst=5)),))
    start = perf_counter()
    taken = sum(bucket.take(start + step / 1000) for step in range(10_000))
    assert taken in (104, 105)  # the burst, and ten a second for ten seconds


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
    session = slow.client().connection.session
    text = finished(slow.server.client_api.metrics(session)).decode()
    assert 'rcp_quota_refused_total{quota="tenant",tenant="alpha",what="requests"} 2.0' in text
