"""Logins at an issuer that come many at once, twice, during a reload or with a planted cookie, and what is kept of them."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack
from typing import Any

import httpx
import msgspec
import pytest

from issuer import Issuer, issuing
from kernel.world import settled
from openid import CLIENT, login_table
from plugins.jwt.people import BACK, LOGIN, TOP, back, people_logging_in, sent
from plugins.jwt.test_login_table import reloaded
from ports import free_port
from rcp_gateway.testing import SteppedClock
from rcp_jwt import code_flow, verified
from rcp_jwt.spent import SpentStates
from rcp_jwt.verified import LoginProofs, Verified
from rcp_jwt.webtokens import Read
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import QueueFull
from transports.robot import BOUND, Site, site, until

pytestmark = pytest.mark.anyio
LIMIT = "/rcp/v1/context/tenant/alpha/param/limit"
WRONG = b'{"error": "invalid_grant"}'


@pytest.fixture
async def issuer() -> AsyncGenerator[Issuer]:
    async with issuing() as made:
        yield made


async def coming_back(
    stack: AsyncExitStack, gateway: Site, number: int
) -> list[tuple[httpx.AsyncClient, dict[str, str]]]:
    """Begin logins in as many browsers; return each with what it comes back with."""
    found: list[tuple[httpx.AsyncClient, dict[str, str]]] = []
    for _ in range(number):
        browser = httpx.AsyncClient(base_url=gateway.url, timeout=BOUND)
        await stack.enter_async_context(browser)
        found.append((browser, {"code": "c", "state": (await sent(browser))["state"]}))
    return found


async def test_wrong_codes_that_arrive_together_get_no_further_than_one_by_one(
    issuer: Issuer,
) -> None:
    issuer.exchanged = WRONG
    limits = "[limits]\nfailed_logins = 2\n"
    async with people_logging_in(issuer, limits) as gateway, AsyncExitStack() as stack:
        coming = await coming_back(stack, gateway, 6)
        issuer.status = b"400 Bad Request"
        answers = await asyncio.gather(*[one.get(BACK, params=given) for one, given in coming])
        assert sorted(one.status_code for one in answers) == [401, 401, 429, 429, 429, 429]
        assert len(issuer.asking) == 2


async def test_logins_that_succeed_together_count_for_nothing(issuer: Issuer) -> None:
    limits = "[limits]\nfailed_logins = 1\n"
    async with people_logging_in(issuer, limits) as gateway:
        for _ in range(3):
            async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
                assert (await back(browser, issuer)).status_code == 303


async def test_wrong_keys_from_an_address_keep_nobody_there_from_the_issuer(issuer: Issuer) -> None:
    limits = "[limits]\nfailed_logins = 2\n"
    async with people_logging_in(issuer, limits) as gateway:
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as program:
            wrong = {"authorization": "Bearer rcp_op_no-such-key"}
            codes = [(await program.get(LIMIT, headers=wrong)).status_code for _ in range(4)]
            assert codes[-1] == 429
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
            assert (await back(browser, issuer)).status_code == 303


async def test_a_login_under_way_is_good_once_also_at_the_same_time(issuer: Issuer) -> None:
    issuer.exchanged = WRONG
    async with people_logging_in(issuer) as gateway, AsyncExitStack() as stack:
        ((browser, given),) = await coming_back(stack, gateway, 1)
        cookie = {"cookie": "; ".join(f"{name}={v}" for name, v in browser.cookies.items())}
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND, headers=cookie) as thief:
            issuer.status = b"400 Bad Request"
            answers = await asyncio.gather(*[thief.get(BACK, params=given) for _ in range(4)])
        assert sorted(one.status_code for one in answers) == [401, 403, 403, 403]
        assert len(issuer.asking) == 1


async def test_whoever_comes_while_all_wait_for_a_slow_issuer_is_told_so_in_time(
    issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code_flow, "_AT_ONCE", 1)
    monkeypatch.setattr(code_flow, "_QUEUED", 0.01)
    async with people_logging_in(issuer) as gateway, AsyncExitStack() as stack:
        (slow, late) = await coming_back(stack, gateway, 2)
        asked = issuer.asked
        issuer.go.clear()
        task = asyncio.create_task(slow[0].get(BACK, params=slow[1]))
        await until(lambda: issuer.asked > asked)
        answer = await late[0].get(BACK, params=late[1])
        assert answer.status_code == 503
        assert "too many people log in at once" in answer.text
        issuer.go.set()
        await task


async def test_a_reload_during_a_login_gives_the_roles_of_now(issuer: Issuer) -> None:
    async with people_logging_in(issuer) as gateway, AsyncExitStack() as stack:
        ((browser, given),) = await coming_back(stack, gateway, 1)
        task = await exchanging(browser, given, issuer)
        reloaded(gateway, lambda text: text.replace('"operator"', '"viewer"'))
        issuer.go.set()
        assert (await task).status_code == 303
        assert (await browser.get(LOGIN)).json()["principal"] == "ann"
        headers = {"origin": gateway.url, "sec-fetch-site": "same-origin"}
        assert (await browser.put(LIMIT, json=1.5, headers=headers)).status_code == 403


@pytest.mark.parametrize(
    ("old", "new", "status"),
    [("[jwt.login]", "[jwt.nothing]", 404), ('"gateway of', '"another gateway of', 403)],
)
async def test_a_login_that_a_reload_takes_away_or_changes_is_refused(
    issuer: Issuer, old: str, new: str, status: int
) -> None:
    async with people_logging_in(issuer) as gateway, AsyncExitStack() as stack:
        ((browser, given),) = await coming_back(stack, gateway, 1)
        task = await exchanging(browser, given, issuer)
        gone = new == "[jwt.nothing]"
        reloaded(gateway, lambda text: text.partition(old)[0] if gone else text.replace(old, new))
        issuer.go.set()
        answer = await task
        assert answer.status_code == status
        assert (await browser.get(LOGIN)).json()["principal"] is None


async def exchanging(
    browser: httpx.AsyncClient, given: dict[str, str], issuer: Issuer
) -> asyncio.Task[httpx.Response]:
    """Come back from the issuer, which has the code and takes its time."""
    began = await browser.get("/rcp/v1/login/oidc/house")
    query = dict(httpx.URL(began.headers["location"]).params)
    token = issuer.token(aud=CLIENT, nonce=query["nonce"], groups=["drivers"])
    issuer.exchanged = json.dumps({"id_token": token}).encode()
    given["state"] = query["state"]
    asked = issuer.asked
    issuer.go.clear()
    task = asyncio.create_task(browser.get(BACK, params=given))
    await until(lambda: issuer.asked > asked)
    return task


async def test_behind_a_proxy_that_adds_tls_a_planted_plain_cookie_is_none(issuer: Issuer) -> None:
    """On this machine, too: the configuration says that the address has TLS."""
    issuer.more |= {"authorization_endpoint": issuer.url, "token_endpoint": issuer.url + "/token"}
    port = free_port()
    more = login_table(issuer.url, port, scheme="https")
    async with site(port=port, top=TOP, more=more) as gateway:
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
            asked = await sent(browser)
        (sealed,) = [one.value for one in browser.cookies.jar]
        token = issuer.token(aud=CLIENT, nonce=asked["nonce"], groups=["drivers"])
        issuer.exchanged = json.dumps({"id_token": token}).encode()
        given = {"code": "c", "state": asked["state"]}
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as planted:
            name = f"rcp_oidc_{port}={sealed}"
            answer = await planted.get(BACK, params=given, headers={"cookie": name})
            assert answer.status_code == 403
            assert "This browser has begun no login" in answer.text
            answer = await planted.get(BACK, params=given, headers={"cookie": "__Host-" + name})
            assert answer.status_code == 303
            (secret,) = [one.value for one in planted.cookies.jar if one.value]
            planted.cookies.clear()
            for cookie, who in ((f"rcp_login_{port}", None), (f"__Host-rcp_login_{port}", "ann")):
                headers = {"cookie": f"{cookie}={secret}"}
                assert (await planted.get(LOGIN, headers=headers)).json()["principal"] == who
                status = (await planted.get(LIMIT, headers=headers)).status_code
                assert status == (401 if who is None else 200)


async def test_what_a_person_has_logged_in_with_is_forgotten_when_the_login_ends(
    issuer: Issuer,
) -> None:
    more = "[features.logins]\nper_person = 1\n"
    async with people_logging_in(issuer, more) as gateway:
        kernel = gateway.server.gateway

        async def proofs() -> int:
            await settled(kernel.store)
            return len(kernel.store.load("jwt.logins"))

        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as first:
            assert (await back(first, issuer)).status_code == 303
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
            assert (await back(browser, issuer)).status_code == 303
            assert await proofs() == 1  # the first one was replaced
            await browser.delete(LOGIN, headers={"origin": gateway.url})
            assert await proofs() == 0


async def test_what_a_login_that_does_not_begin_came_with_is_forgotten(issuer: Issuer) -> None:
    async with people_logging_in(issuer, "[features.logins]\nmost = 1\n") as gateway:
        kernel = gateway.server.gateway
        for name, status in (("ann", 303), ("bob", 503)):
            async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
                assert (await back(browser, issuer, sub=name)).status_code == status
        await settled(kernel.store)
        assert len(kernel.store.load("jwt.logins")) == 1


def proof(name: str, seconds: float = 600.0) -> Verified:
    claims: dict[str, Any] = {"exp": int(time.time() + seconds)}
    principal = Principal(name, (), "jwt i")
    return Verified(claims, "k", Read("i", "ES256", "k"), client="c", principal=principal)


def test_many_logins_of_one_person_end_none_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verified, "_PER_PERSON", 2)
    monkeypatch.setattr(verified, "_LOGINS", 4)
    kept = LoginProofs(SteppedClock().clock, None)
    kept.keep("a1", proof("ann"))
    for number in range(5):
        kept.keep(f"b{number}", proof("bob"))
    kept.keep("b4", msgspec.structs.replace(proof("bob"), tables=object()))  # used again
    assert [one for one in ("a1", "b2", "b3", "b4") if kept.get(one)] == ["a1", "b3", "b4"]
    kept.keep("c1", proof("cem"))
    with pytest.raises(QueueFull):
        kept.keep("d1", proof("dan"))
    kept.forget("c1")
    kept.keep("d1", proof("dan"))
    assert kept.get("a1") is not None


def test_what_has_expired_is_dropped() -> None:
    clock = SteppedClock()
    kept = LoginProofs(clock.clock, None)
    kept.keep("short", proof("ann", 600))
    kept.keep("long", proof("ann", 6000))
    clock.advance(3000)
    kept.drop_expired()
    assert kept.get("short") is None
    assert kept.get("long") is not None


def test_a_used_state_is_remembered_for_as_long_as_it_could_be_used() -> None:
    spent = SpentStates(100)
    assert spent.use("a", 0)
    assert not spent.use("a", 0)
    assert not spent.use("a", 100)
    assert spent.use("b", 101)
    assert spent.use("a", 101)
