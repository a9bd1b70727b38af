"""What goes wrong when people log in at an issuer: nobody gets in by it, and everybody is told what to do."""

from __future__ import annotations

import json
import time
from base64 import b64decode
from collections.abc import AsyncGenerator
from typing import Any
from urllib.parse import parse_qs, unquote_plus, urlencode, urlsplit

import httpx
import jwt
import pytest

from issuer import Issuer, issuing
from kernel.world import settled
from openid import CLIENT, SECRET, login_table
from plugins.jwt.people import BACK, BEGIN, LOGIN, TOP, back, people_logging_in, sent
from ports import free_port
from rcp_jwt import code_flow, issuers
from transports.robot import BOUND, Site, site

pytestmark = pytest.mark.anyio
PATIENT = "[limits]\nfailed_logins = 1000\n"


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    """Keep one event loop for a file, so that the gateway lives as long as its tests."""
    return "asyncio"


@pytest.fixture(scope="module")
async def issuer() -> AsyncGenerator[Issuer]:
    async with issuing() as made:
        yield made


@pytest.fixture(scope="module")
async def gateway(issuer: Issuer) -> AsyncGenerator[Site]:
    async with people_logging_in(issuer, PATIENT) as made:
        yield made


@pytest.fixture
async def browser(gateway: Site) -> AsyncGenerator[httpx.AsyncClient]:
    async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as made:
        yield made


async def nobody(browser: httpx.AsyncClient, answer: httpx.Response, text: str) -> None:
    """Check that a login has failed with a page that says why, and how to go on."""
    assert text in answer.text
    assert "You are not logged in" in answer.text
    assert ">Log in with House &amp; Co</a>" in answer.text
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.headers["cache-control"] == "no-store"
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert (await browser.get(LOGIN)).json()["principal"] is None


async def test_a_person_is_who_the_token_says(browser: httpx.AsyncClient, issuer: Issuer) -> None:
    assert (await back(browser, issuer)).status_code == 303
    assert (await browser.get(LOGIN)).json()["principal"] == "ann"
    head, form = issuer.asking[-1]
    assert form.keys() == {"grant_type", "code", "redirect_uri", "code_verifier"}
    pair = b64decode(head.partition("Authorization: Basic ")[2].split()[0]).decode()
    assert [unquote_plus(one) for one in pair.split(":")] == [CLIENT, SECRET]


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"nonce": "of another login"}, "its `nonce` is another"),
        ({"nonce": None}, "its `nonce` is another"),
        ({"nonce": ["x"]}, "its `nonce` is another"),
        ({"aud": "another client"}, "for another audience"),
        ({"aud": "programs of this test"}, "for another audience"),
        ({"aud": [CLIENT, "another client"]}, "given to another client"),
        ({"aud": [CLIENT, "other"], "azp": "other"}, "given to another client"),
        ({"azp": "another client"}, "given to another client"),
        ({"exp": 1_000_000_000}, "has expired"),
        ({"exp": None}, "needs the claims"),
        ({"iat": 4_000_000_000}, "not valid yet"),
        ({"iss": "https://elsewhere.example"}, "of another issuer"),
        ({"groups": ["guests"]}, "no role on this gateway"),
        ({"sub": "a\nb"}, "not a valid name"),
    ],
    ids=str,
)
async def test_a_token_that_is_not_for_this_login_logs_nobody_in(
    browser: httpx.AsyncClient, issuer: Issuer, changed: dict[str, Any], text: str
) -> None:
    await nobody(browser, await back(browser, issuer, **changed), text)


@pytest.mark.parametrize(
    ("algorithm", "key", "text"),
    [
        ("none", None, "malformed"),
        ("HS256", SECRET, "algorithm is not accepted"),
        ("HS256", "PUBLIC", "algorithm is not accepted"),
    ],
)
async def test_a_token_that_the_issuer_did_not_sign_logs_nobody_in(
    browser: httpx.AsyncClient, issuer: Issuer, algorithm: str, key: str | None, text: str
) -> None:
    now = int(time.time())
    claims = {"iss": issuer.url, "aud": CLIENT, "sub": "ann", "iat": now, "exp": now + 60}
    if key == "PUBLIC":
        key = issuer.keys["k1"].jwk["x"]
    token = jwt.encode({**claims, "groups": ["drivers"]}, key, algorithm, headers={"kid": "k1"})
    await nobody(browser, await back(browser, issuer, token), text)


@pytest.mark.parametrize(
    ("status", "body", "code", "text"),
    [
        (b"400 Bad Request", b'{"error": "invalid_grant"}', 401, "used already, or is too old"),
        (b"401 Unauthorized", b'{"error": "invalid_client"}', 503, "does not accept `client_id`"),
        (b"400 Bad Request", b'{"error": "<b>"}', 401, "did not accept the code"),
        (b"429 Too Many", b"", 401, "did not accept the code"),
        (b"500 No", b"<html>", 503, "not the one expected"),
        (b"302 Found", b"", 503, "not the one expected"),
        (b"200 OK", b"{}", 503, "not the one expected"),
        (b"200 OK", b'{"id_token": 1}', 503, "not the one expected"),
        (b"200 OK", b'{"id_token": "x.y.z"}', 401, "malformed"),
        (b"200 OK", b"[" * 90_000, 503, "not the one expected"),
        (b"200 OK", b" " * 600_000, 503, "does not answer"),
        (b"200 OK", None, 503, "does not answer"),
    ],
)
async def test_an_issuer_that_gives_no_token_logs_nobody_in(
    browser: httpx.AsyncClient,
    issuer: Issuer,
    status: bytes,
    body: bytes | None,
    code: int,
    text: str,
) -> None:
    asked = await sent(browser)
    issuer.status, issuer.exchanged = status, body
    try:
        answer = await browser.get(BACK, params={"code": "c", "state": asked["state"]})
    finally:
        issuer.status = b"200 OK"
    assert answer.status_code == code
    assert ("retry-after" in answer.headers) == (code == 503)
    await nobody(browser, answer, text)
    assert "Max-Age=0" in answer.headers["set-cookie"]  # of the login that was under way


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"state": "another", "code": "c"}, "not the answer to the login"),
        ({"code": "c"}, "not the answer to the login"),
        ({"state": "STATE"}, "has no code"),
        ({"state": "STATE", "code": ""}, "has no code"),
        ({"state": "STATE", "code": "c" * 3000}, "has no code"),
        ({"state": "STATE", "code": "c", "iss": "https://elsewhere.example"}, "of another issuer"),
        ({"state": "STATE", "error": "access_denied"}, "refused or cancelled at House &amp; Co"),
        ({"state": "STATE", "error": "server_error"}, "failed to log you in"),
        ({"state": "STATE", "error": "<script>"}, "did not accept how this gateway asks"),
    ],
    ids=str,
)
async def test_an_answer_to_no_login_or_without_a_code_is_refused(
    browser: httpx.AsyncClient, issuer: Issuer, given: dict[str, str], text: str
) -> None:
    asked = await sent(browser)
    exchanges = len(issuer.asking)
    known = {key: asked["state"] if one == "STATE" else one for key, one in given.items()}
    answer = await browser.get(BACK, params={**known, "error_description": "Call 555-0100"})
    assert answer.status_code == 403
    await nobody(browser, answer, text)
    assert "555" not in answer.text  # anybody may have written it
    assert "<script>" not in answer.text
    assert len(issuer.asking) == exchanges


async def test_a_parameter_that_occurs_twice_is_refused(browser: httpx.AsyncClient) -> None:
    asked = await sent(browser)
    query = urlencode([("state", asked["state"]), ("code", "a"), ("code", "b")])
    assert (await browser.get(f"{BACK}?{query}")).status_code == 400


@pytest.mark.parametrize("sealed", ["", "x", "AAAA" * 40, "é"])
async def test_a_cookie_that_this_gateway_did_not_make_is_no_login(
    gateway: Site, browser: httpx.AsyncClient, sealed: str
) -> None:
    cookie = f"rcp_oidc_{gateway.port}={sealed}".encode()
    answer = await browser.get(BACK, params={"code": "c", "state": ""}, headers={b"cookie": cookie})
    assert answer.status_code == 403
    assert "This browser has begun no login" in answer.text


async def test_a_login_that_takes_too_long_is_begun_anew(
    browser: httpx.AsyncClient, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = await sent(browser)
    monkeypatch.setattr(code_flow, "_LIFETIME", -1)
    answer = await browser.get(BACK, params={"code": "c", "state": asked["state"]})
    assert answer.status_code == 403
    await nobody(browser, answer, "took too long")


@pytest.mark.parametrize(
    ("page", "place"),
    [
        ("/", "/"),
        ("/#/explore?path=/tenant/a", "/#/explore?path=/tenant/a"),
        ("//evil.example/", "//evil.example/"),  # a path, behind the gateway's own address
        ("/\\evil.example", "/%5Cevil.example"),
        ("/é", "/%C3%A9"),
        ("https://evil.example/", None),
        ("evil.example", None),
        (".evil.example", None),
        ("@evil.example", None),
        (":1@evil.example", None),
        ("/\r\nset-cookie: a=b", None),
        ("/\t/evil.example", None),
        ("", None),
        ("/" + "x" * 2000, None),
    ],
)
async def test_the_page_after_a_login_is_one_of_the_gateway(
    gateway: Site, browser: httpx.AsyncClient, issuer: Issuer, page: str, place: str | None
) -> None:
    answer = await browser.get(BEGIN, params={"next": page})
    if place is None:
        assert answer.status_code == 403
        assert "`next` is not a page of this gateway" in answer.text
        return
    asked = parse_qs(urlsplit(answer.headers["location"]).query)
    token = issuer.token(aud=CLIENT, nonce=asked["nonce"][0], groups=["drivers"])
    issuer.exchanged = json.dumps({"id_token": token}).encode()
    answer = await browser.get(BACK, params={"code": "c", "state": asked["state"][0]})
    assert answer.headers["location"] == gateway.url + place


@pytest.mark.parametrize("place", ["cross-site", "same-site"])
async def test_no_other_page_has_its_visitors_log_in(
    browser: httpx.AsyncClient, place: str
) -> None:
    headers = {
        "sec-fetch-site": place,
        "sec-fetch-mode": "navigate",
        "sec-fetch-dest": "document",
    }
    answer = await browser.get(BEGIN, headers=headers)
    assert answer.status_code == 403
    assert "choose it here yourself" in answer.text
    assert "set-cookie" not in answer.headers


async def test_a_browser_at_another_address_is_told_the_right_one(
    gateway: Site, browser: httpx.AsyncClient
) -> None:
    answer = await browser.get(BEGIN, headers={"host": f"localhost:{gateway.port}"})
    assert answer.status_code == 400
    assert f"is for the address {gateway.url}" in answer.text
    assert "set-cookie" not in answer.headers


@pytest.mark.parametrize("path", ["/rcp/v1/login/oidc/other", "/rcp/v1/login/oidc/other/callback"])
async def test_an_issuer_that_is_not_there_is_told_so(
    browser: httpx.AsyncClient, path: str
) -> None:
    answer = await browser.get(path)
    assert answer.status_code == 404
    assert "no such login" in answer.text


async def test_an_answer_counts_only_at_the_address_of_its_issuer(issuer: Issuer) -> None:
    """One issuer must not hand over its code as if it were of the other one."""
    async with issuing() as other:
        other.more = {"authorization_endpoint": other.url, "token_endpoint": other.url + "/token"}
        second = login_table(other.url, 0).replace('"house"', '"other"').replace(":0", ":PORT")
        port = free_port()
        more = login_table(issuer.url, port) + second.replace("PORT", str(port))
        async with (
            site(port=port, top=TOP, more=more) as gateway,
            httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
        ):
            asked = await sent(browser)
            exchanges = len(other.asking)
            given = {"code": "c", "state": asked["state"]}
            answer = await browser.get("/rcp/v1/login/oidc/other/callback", params=given)
            assert answer.status_code == 403
            assert len(other.asking) == exchanges


async def test_an_issuer_that_says_who_it_is_must_always_say_so() -> None:
    async with issuing() as issuer:
        issuer.more["authorization_response_iss_parameter_supported"] = True
        async with (
            people_logging_in(issuer) as gateway,
            httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
        ):
            asked = await sent(browser)
            given = {"code": "c", "state": asked["state"]}
            assert (await browser.get(BACK, params=given)).status_code == 403
            answer = await browser.get(BACK, params={**given, "iss": issuer.url})
            assert answer.status_code == 503  # it gets as far as the exchange


async def test_an_issuer_that_is_down_is_told_of_and_asked_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    async with issuing() as issuer:
        issuer.status = b"503 No"
        async with (
            people_logging_in(issuer) as gateway,
            httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
        ):
            answer = await browser.get(BEGIN)
            assert answer.status_code == 503
            assert "127.0.0.1 cannot log anybody in at present" in answer.text
            issuer.status = b"200 OK"
            assert (await browser.get(BEGIN)).status_code == 303


async def test_an_issuer_where_people_cannot_log_in_is_told_of() -> None:
    async with issuing() as issuer:
        port = free_port()
        async with (
            site(port=port, top=TOP, more=login_table(issuer.url, port)) as gateway,
            httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
        ):
            answer = await browser.get(BEGIN)
            assert answer.status_code == 503
            assert "does not offer the login of people" in answer.text


async def test_a_failed_login_is_on_record(issuer: Issuer) -> None:
    async with (
        people_logging_in(issuer) as gateway,
        httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
    ):
        await back(browser, issuer, nonce="x")
        kernel = gateway.server.gateway
        await settled(kernel.store)
        newest = kernel.registry.entries["/system/audit"].ring[-1].value
        assert newest["what"] == "denial"
        assert "its `nonce` is another" in newest["message"]


async def test_a_login_that_is_refused_for_the_many_before_is_on_record(issuer: Issuer) -> None:
    async with (
        people_logging_in(issuer, "[limits]\nfailed_logins = 1\n") as gateway,
        httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
    ):
        assert [(await back(browser, issuer, nonce="x")).status_code for _ in "ab"] == [401, 429]
        kernel = gateway.server.gateway
        await settled(kernel.store)
        newest = kernel.registry.entries["/system/audit"].ring[-1].value
        assert (newest["what"], newest["outcome"]) == ("denial", "rate_limited")


async def test_wrong_codes_of_one_address_are_slowed_and_no_burden_to_the_issuer(
    issuer: Issuer,
) -> None:
    async with (
        people_logging_in(issuer, "[limits]\nfailed_logins = 2\n") as gateway,
        httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
    ):
        before = len(issuer.asking)
        told = [(await back(browser, issuer, nonce="x")).status_code for _ in range(4)]
        assert told == [401, 401, 429, 429]
        assert len(issuer.asking) == before + 2
