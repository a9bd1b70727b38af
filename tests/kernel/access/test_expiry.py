"""The end of a proof ends what it opened; a new one in time keeps it."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator
from typing import Any

import pytest

from issuer import Issuer, issuing
from kernel.world import CONFIG, World, prepared, world_of
from rcp_gateway.reload import apply
from rcp_gateway.testing import SteppedClock
from rcp_kernel.clock import Clock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import TokenExpired, Unauthenticated

pytestmark = pytest.mark.anyio


@pytest.fixture
async def issuer() -> AsyncGenerator[Issuer]:
    async with issuing() as made:
        yield made


@pytest.fixture
async def world(issuer: Issuer, gateway_clock: Clock) -> AsyncGenerator[World]:
    key = issuer.keys["k1"].pem.replace("\n", "\\n")
    more = 'role_claim = "role"\nleeway = 0.0\n[jwt.by_claim]\n'
    more += 'operator = { role = "operator" }\nviewer = { role = "viewer" }\n'
    async with world_of(
        CONFIG + issuer.table(more, f'keys = "{key}"'), clock=gateway_clock
    ) as made:
        yield made


def token(issuer: Issuer, left: float, **claims: Any) -> str:
    return issuer.token(exp=int(time.time() + left), role=claims.pop("role", "operator"), **claims)


async def test_a_session_is_warned_and_then_ends(
    world: World, issuer: Issuer, stepped: SteppedClock
) -> None:
    client = world.client(token(issuer, 300))
    await client.ask(type="subscribe", path="/sensor/level", id="s")
    await client.ask(type="execute", path="/action/go", body=1.0, id="x", dry_run=True)
    client.send(type="execute", path="/action/go", body=2.0, id="go")
    await client.until(lambda m: m.get("status") == "in_progress")
    stepped.advance(285)
    warned = await client.notice("session_expiring")
    assert "hello" in warned["remedy"]
    assert not client.connection.expelled
    stepped.advance(100)
    ended = await client.notice("subscription_ended")
    assert (ended["id"], ended["reason"], ended["error"]["code"]) == ("s", *2 * ("token_expired",))
    assert (await client.final(None))["error"]["code"] == "token_expired"
    assert client.connection.expelled
    assert not world.server.gateway.hub.subscriptions
    assert world.robot.stopped.qsize() == 0  # what runs goes on
    world.robot.release.set()


async def test_a_new_token_of_the_same_principal_keeps_what_there_is(
    world: World, issuer: Issuer, stepped: SteppedClock
) -> None:
    client = world.client(token(issuer, 200))
    await client.ask(type="subscribe", path="/sensor/level", id="s")
    asked = {"do": "acquire", "scope": "/tenant/alpha", "ttl": 300}
    lease = await client.ask(type="execute", path="/system/leases", body=asked)
    assert lease["status"] == "completed", lease
    first = await client.ask(type="hello")
    stepped.advance(185)
    await client.notice("session_expiring")
    fresh = await client.ask(type="hello", body={"token": token(issuer, 600)})
    assert fresh["body"]["session"] == first["body"]["session"]
    renewed = {"do": "renew", "lease": lease["body"]["lease"], "ttl": 300}
    await client.ask(type="execute", path="/system/leases", body=renewed)
    await _past(world, stepped)
    world.robot.host.publish("sensor/level", 7.0)
    assert (await client.update("s"))["body"] == 7.0
    held = await client.ask(type="read", path="/system/leases")
    assert len(held["body"]) == 1
    assert not client.connection.expelled


async def _past(world: World, stepped: SteppedClock) -> None:
    """Let the first token's time pass, and whatever that leads to happen."""
    stepped.advance(100)
    for _ in range(3):
        await world.client().ask(type="read", path="/param/limit", body={"fresh": True})


async def test_a_token_of_somebody_else_opens_another_session(world: World, issuer: Issuer) -> None:
    client = world.client(token(issuer, 600))
    first = await client.ask(type="hello")
    await client.ask(type="subscribe", path="/sensor/level", id="s")
    other = await client.ask(type="hello", body={"token": token(issuer, 600, sub="bea")})
    assert other["body"]["principal"] == "bea"
    assert other["body"]["session"] != first["body"]["session"]
    assert not world.server.gateway.hub.subscriptions


async def test_a_new_token_with_lesser_roles_takes_rights_away(
    world: World, issuer: Issuer
) -> None:
    client = world.client(token(issuer, 600))
    assert (await client.ask(type="write", path="/param/limit", body=1.0))["status"] == "completed"
    await client.ask(type="hello", body={"token": token(issuer, 600, role="viewer")})
    denied = await client.ask(type="write", path="/param/limit", body=1.0)
    assert denied["error"]["code"] == "forbidden"


async def test_who_comes_back_with_a_new_token_finds_the_session(
    world: World, issuer: Issuer
) -> None:
    client = world.client(token(issuer, 600))
    first = await client.ask(type="hello")
    await client.ask(type="subscribe", path="/sensor/level", id="s")
    client.connection.close()
    back = world.client(token(issuer, 601, jti="new"))
    hello = await back.ask(type="hello", body={"session": first["body"]["session"]})
    assert hello["body"]["session"] == first["body"]["session"]
    world.robot.host.publish("sensor/level", 8.0)
    assert (await back.until(lambda m: m["type"] == "update" and m["body"] == 8.0))["id"] == "s"


async def test_a_namesake_of_another_issuer_is_somebody_else(world: World, issuer: Issuer) -> None:
    client = world.client("operator-operator")
    first = await client.ask(type="hello")
    namesake = world.client(token(issuer, 600, sub="operator"))
    stolen = await namesake.ask(type="hello", body={"session": first["body"]["session"]})
    assert stolen["error"]["code"] == "unauthenticated"


async def test_a_session_that_waits_for_its_client_ends_too(
    world: World, issuer: Issuer, stepped: SteppedClock
) -> None:
    short = token(issuer, 40)
    client = world.client(short)
    first = await client.ask(type="hello")
    client.connection.close()
    await _past(world, stepped)
    assert not [s for s in world.server.gateway.sessions.known.values() if s.cut is not None]
    with pytest.raises(TokenExpired):
        world.client(short)
    late = await world.client().ask(type="hello", body={"session": first["body"]["session"]})
    assert late["error"]["code"] == "gap"


async def test_an_issuer_that_leaves_the_configuration_ends_its_sessions(
    world: World, issuer: Issuer
) -> None:
    client = world.client(token(issuer, 600))
    await client.ask(type="ping")
    await apply(world.server, prepared(parse(CONFIG, "test"), []))
    assert (await client.final(None))["error"]["code"] == "token_expired"


async def test_a_token_that_was_verified_is_weighed_by_the_tables_of_a_reload(
    issuer: Issuer,
) -> None:
    key = issuer.keys["k1"].pem.replace("\n", "\\n")

    def config(role: str) -> str:
        more = f'role_claim = "role"\n[jwt.by_claim]\noperator = {{ role = "{role}" }}\n'
        return CONFIG + issuer.table(more, f'keys = "{key}"')

    other = config("viewer").replace('audience = "', 'audience = "other-')
    async with world_of(config("operator")) as world:
        identities, good = world.server.gateway.identities, token(issuer, 600)
        found = identities.known(good)
        assert found is not None
        assert found.roles == ("operator",)
        await apply(world.server, prepared(parse(config("viewer"), "test"), []))
        found = identities.known(good)
        assert found is not None
        assert found.roles == ("viewer",)
        await apply(world.server, prepared(parse(other, "test"), []))
        with pytest.raises(Unauthenticated):
            identities.known(good)
