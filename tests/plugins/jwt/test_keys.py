"""The keys of an issuer come, go, lapse and cannot be had."""

from __future__ import annotations

import time
from typing import Any

import pytest

from issuer import Issuer, Key, issuing, who
from kernel.world import CONFIG, World, prepared, world_of
from rcp_gateway.reload import apply
from rcp_gateway.testing import SteppedClock
from rcp_jwt import documents, issuers
from rcp_kernel.config.file import parse
from rcp_kernel.errors import (
    AdapterUnavailable,
    Unauthenticated,
)

pytestmark = pytest.mark.anyio


async def test_a_new_key_of_the_issuer_works_at_once(
    world: World, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    await who(world, issuer.token())
    issuer.add("k2", "RS256")
    assert (await who(world, issuer.token("k2"))).name == "ann"


async def test_unknown_keys_do_not_make_the_gateway_ask_without_end(
    world: World, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_WAIT", 0.2)
    await who(world, issuer.token())
    asked = issuer.asked
    issuer.keys["unlisted"] = Key("unlisted", "ES256")
    for number in range(5):
        with pytest.raises(Unauthenticated, match="does not publish"):
            await who(world, issuer.token("unlisted", n=number))
    assert issuer.asked - asked <= 2  # one fetch is two requests


async def test_a_key_that_is_gone_ends_what_it_opened(
    issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    async with world_of(CONFIG + issuer.table()) as world:
        token = issuer.token()
        await who(world, token)
        client = world.client(token)
        issuer.add("k2")
        issuer.listed.remove("k1")
        await who(world, issuer.token("k2"))
        assert (await client.final(None))["error"]["code"] == "token_expired"
        with pytest.raises(Unauthenticated):
            await who(world, token)


@pytest.mark.parametrize(
    "trouble",
    [
        pytest.param({"body": b"garbage"}, id="garbage"),
        pytest.param({"body": b"x" * 10_000_000}, id="endless"),
        pytest.param({"body": b'{"keys": []}'}, id="no keys"),
        pytest.param({"body": b'{"keys": [{"kty": "oct", "k": "c2VjcmV0"}]}'}, id="a secret"),
        pytest.param({"body": b"[" * 100_000}, id="deep"),
        pytest.param({"status": b"302 Found"}, id="elsewhere"),
        pytest.param({"status": b"500 No"}, id="failing"),
        pytest.param({"named": "https://elsewhere.example"}, id="of another"),
    ],
)
async def test_an_issuer_in_trouble_is_told_of_and_asked_again(
    trouble: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    async with issuing() as issuer:
        for name, value in trouble.items():
            setattr(issuer, name, value)
        async with world_of(CONFIG + issuer.table()) as world:
            with pytest.raises(AdapterUnavailable, match="cannot be fetched"):
                await who(world, issuer.token())
            status = await world.client("admin-admin-admin").ask(type="status")
            facts = next(a for a in status["body"]["adapters"] if a["name"].startswith("jwt "))
            assert (facts["name"], facts["state"]) == (f"jwt {issuer.url}", "down")
            assert (await world.client().ask(type="ping"))["status"] == "completed"
            issuer.body, issuer.status, issuer.named = None, b"200 OK", None
            assert (await who(world, issuer.token())).name == "ann"
            status = await world.client("admin-admin-admin").ask(type="status")
            assert {"name": facts["name"], "state": "ready"} in status["body"]["adapters"]


async def test_a_slow_issuer_holds_up_nobody_else(
    issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(documents, "_PATIENCE", 0.3)
    monkeypatch.setattr(issuers, "_WAIT", 0.5)
    issuer.go.clear()
    async with world_of(CONFIG + issuer.table()) as world:
        client = world.client(None)
        client.send(type="hello", id="h", body={"token": issuer.token()})
        client.send(type="ping", id="p")
        assert (await world.client().ask(type="ping"))["status"] == "completed"
        assert not client.inbox
        assert (await client.final("h"))["error"]["code"] == "adapter_unavailable"
        assert (await client.final("p"))["status"] == "completed"


async def test_known_keys_go_on_while_the_issuer_is_down(
    issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    async with world_of(CONFIG + issuer.table()) as world:
        await who(world, issuer.token())
        issuer.status = b"500 No"
        issuer.keys["k2"] = Key("k2", "ES256")
        with pytest.raises(Unauthenticated):
            await who(world, issuer.token("k2"))
        assert (await who(world, issuer.token(jti="another"))).name == "ann"


async def test_a_key_taken_back_ends_what_it_opened_with_the_next_fetch(
    issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    issuer.add("k2")
    async with world_of(CONFIG + issuer.table('role = "operator"\nrefresh = 1')) as world:
        old, new = issuer.token(), issuer.token("k2", sub="bea")
        await who(world, old)
        await who(world, new)
        loser, keeper = world.client(old), world.client(new)
        await loser.ask(type="subscribe", path="/sensor/level", id="s")
        issuer.listed.remove("k1")  # and nobody asks for another key
        assert (await loser.notice("subscription_ended"))["reason"] == "token_expired"
        assert (await loser.final(None))["error"]["code"] == "token_expired"
        assert (await keeper.ask(type="ping"))["status"] == "completed"
        with pytest.raises(Unauthenticated, match="does not publish"):
            await who(world, old)


async def test_keys_that_lapse_take_with_them_what_they_signed(
    issuer: Issuer, stepped: SteppedClock
) -> None:
    table = issuer.table('role = "operator"\nrefresh = 600\nlifetime = 3600')
    async with world_of(CONFIG + table, clock=stepped.clock) as world:
        token = issuer.token(exp=int(time.time()) + 86_400)
        await who(world, token)
        client = world.client(token)
        await client.ask(type="subscribe", path="/sensor/level", id="s")
        issuer.status = b"500 No"
        stepped.advance(4000)
        assert (await client.notice("subscription_ended"))["reason"] == "token_expired"
        assert (await client.final(None))["error"]["code"] == "token_expired"
        with pytest.raises(AdapterUnavailable):
            await who(world, token)
        issuer.status = b"200 OK"
        stepped.advance(4000)
        assert (await who(world, token)).name == "ann"


async def test_keys_that_lapsed_are_good_again_only_by_a_longer_lifetime(
    issuer: Issuer, stepped: SteppedClock
) -> None:
    table = issuer.table('role = "operator"\nrefresh = 600\nlifetime = 3600')
    async with world_of(CONFIG + table, clock=stepped.clock) as world:
        token = issuer.token(exp=int(time.time()) + 86_400)
        await who(world, token)
        client = world.client(token)
        issuer.status = b"500 No"
        stepped.advance(4000)
        assert (await client.final(None))["error"]["code"] == "token_expired"
        await apply(world.server, prepared(parse(CONFIG + table, "test"), []))
        with pytest.raises(AdapterUnavailable):
            await who(world, token)
        longer = table.replace("lifetime = 3600", "lifetime = 80000")
        await apply(world.server, prepared(parse(CONFIG + longer, "test"), []))
        assert (await who(world, token)).name == "ann"
