"""Wrong tokens of one address, on a real socket: slowed, told, and in nobody else's way."""

from __future__ import annotations

import base64
import json
import time
from typing import Any

import httpx
import jwt
import pytest
from structlog.testing import capture_logs

from issuer import AUDIENCE, Issuer, issuing
from transports.raw import TEXT, frame, opened
from transports.robot import KEY, site

pytestmark = pytest.mark.anyio
PARAM = "/rcp/v1/context/tenant/alpha/param/limit"


@pytest.fixture(autouse=True)
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have an address recover from none of its failures while a test runs."""
    monkeypatch.setattr("rcp_kernel.access.auth_throttle._PERIOD", 60_000.0)


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


async def test_wrong_keys_of_one_address_lock_out_no_right_one() -> None:
    async with (
        issuing() as issuer,
        site(more=issuer.table()) as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
    ):
        issuer.add("k2")
        wrong = [
            (await http.get(PARAM, headers=bearer(f"guess-{n}"))).status_code for n in range(40)
        ]
        assert wrong == [401] * 30 + [429] * 10
        told = await http.get(PARAM, headers=bearer("guess-more"))
        assert int(told.headers["retry-after"]) >= 1
        assert told.json()["error"]["code"] == "rate_limited"
        # Right ones that the gateway has never seen, by each way in.
        assert (await http.put(PARAM, json=1, headers=bearer(KEY))).status_code == 200
        time.sleep(0.02)  # noqa: ASYNC251 - the pace of signatures after a wrong token
        signed = await http.put(PARAM, json=1, headers=bearer(issuer.token()))
        assert signed.status_code == 200
        async with opened(gateway) as raw:
            raw.send(frame(TEXT, json.dumps({"type": "hello", "body": {"token": "bad"}}).encode()))
            assert (await raw.reply())["error"]["code"] == "rate_limited"
            hello = {"type": "hello", "body": {"token": "key-of-tenant-beta"}}
            raw.send(frame(TEXT, json.dumps(hello).encode()))
            assert (await raw.reply())["body"]["principal"] == "beta-only"


async def test_behind_a_listed_proxy_each_client_has_its_own_patience() -> None:
    async with (
        site(asgi='proxies = ["127.0.0.1"]', more="[limits]\nfailed_logins = 3") as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
    ):

        async def guess(seen: str) -> int:
            headers = bearer("guess") | {"x-forwarded-for": seen}
            return (await http.get(PARAM, headers=headers)).status_code

        assert [await guess(f"2001:db8::{n}") for n in range(4)] == [401, 401, 401, 429]
        assert await guess("2001:db8:0:1::1") == 401
        assert await guess("2001:db8:0:2::1, 2001:db8::7") == 429  # the left one is its own word


# -- tokens that are not what they say -------------------------------------------------------------


def packed(part: bytes | dict[str, Any]) -> bytes:
    data = part if isinstance(part, bytes) else json.dumps(part).encode()
    return base64.urlsafe_b64encode(data).rstrip(b"=")


def signed(issuer: Issuer, head: bytes, claims: bytes) -> str:
    """Sign whatever the two parts are with the issuer's real key."""
    key = issuer.keys["k1"]
    text = packed(head) + b"." + packed(claims)
    signature = jwt.get_algorithm_by_name(key.algorithm).sign(text, key.private)
    return (text + b"." + packed(signature)).decode()


def tricks(issuer: Issuer) -> dict[str, str]:
    now = int(time.time())
    good = {"iss": issuer.url, "aud": AUDIENCE, "sub": "ann", "exp": now + 600}
    head = {"alg": "ES256", "typ": "JWT", "kid": "k1"}
    text = json.dumps(good).encode()

    def own(claims: dict[str, Any] | None = None, **heads: Any) -> str:
        return signed(
            issuer, json.dumps(head | heads).encode(), json.dumps(good | (claims or {})).encode()
        )

    def exp(value: bytes) -> str:
        return signed(issuer, json.dumps(head).encode(), text.replace(b"%d" % (now + 600), value))

    def unsigned(algorithm: str) -> str:
        return (packed(head | {"alg": algorithm}) + b"." + packed(good) + b".").decode()

    public = issuer.keys["k1"].pem.encode()
    body = packed(head | {"alg": "HS256"}) + b"." + packed(good)
    mac = jwt.get_algorithm_by_name("HS256")
    confused = mac.sign(body, public)  # the public key as an HMAC secret
    return {
        "none": unsigned("none"),
        "NONE": unsigned("NoNe"),
        "no signature": own().rpartition(".")[0] + ".",
        "confused": (body + b"." + packed(confused)).decode(),
        "kid is a file": own(kid="../../../../dev/null"),
        "kid is SQL": own(kid="' OR 1=1 --"),
        "kid is a number": own(kid=1),
        "crit": own(crit=["exp"]),
        "crit unknown": own(crit=["x"], x=1),
        "alg is a list": own(alg=["ES256"]),
        "alg is null": own(alg=None),
        "exp is text": own({"exp": "tomorrow"}),
        "exp is a list": own({"exp": [now + 600]}),
        "exp is null": own({"exp": None}),
        "exp is infinite": exp(b"1e999"),
        "exp is NaN": exp(b"NaN"),
        "exp has digits": exp(b"9" * 9000),
        "nbf is text": own({"nbf": "x"}),
        "nbf is a list": own({"nbf": []}),
        "nbf ahead": own({"nbf": now + 6000}),
        "aud is a map": own({"aud": {"x": 1}}),
        "iss is a list": own({"iss": [issuer.url]}),
        "claims twice": signed(issuer, json.dumps(head).encode(), text[:-1] + b', "sub": "root"}'),
        "head twice": signed(issuer, json.dumps(head).encode()[:-1] + b', "alg": "none"}', text),
        "no UTF-8": signed(issuer, json.dumps(head).encode(), text[:-1] + b', "x": "\xff\xfe"}'),
        "head no UTF-8": signed(issuer, b'{"alg": "\xff"}', text),
        "claims are a list": signed(issuer, json.dumps(head).encode(), b"[1]"),
        "claims are nothing": signed(issuer, json.dumps(head).encode(), b""),
        "head is a list": signed(issuer, b"[1]", text),
        "deep": signed(issuer, json.dumps(head).encode(), b"[" * 9000),
        "huge": own({"x": "y" * 20_000}),
        "dots": "eyJ..",
        "more dots": own() + ".x",
        "white space": own()[:40] + " " + own()[40:],
        "padded": own() + "==",
        "signature with more": own()[:-5] + "!" + own()[-5:],
        "not base64": "eyJ\xe9.eyJ\xe9.\xe9",
    }


async def test_each_token_that_is_none_is_401_and_a_line_at_most() -> None:
    more = "[limits]\nfailed_logins = 100000\n"
    async with (
        issuing() as issuer,
        site(more=issuer.table() + more) as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
    ):
        assert (await http.put(PARAM, json=1, headers=bearer(issuer.token()))).status_code == 200
        for name, token in tricks(issuer).items():
            headers = {b"authorization": b"Bearer " + token.encode("latin-1")}
            with capture_logs() as lines:
                answer = await http.put(PARAM, json=1, headers=headers)  # type: ignore[arg-type]
            assert answer.status_code == 401, (name, answer.text)
            assert answer.headers["www-authenticate"] == "Bearer"
            assert len(lines) <= 1, (name, lines)
            assert not any("exception" in line or "exc_info" in line for line in lines), lines
            assert token not in answer.text + str(lines)
        longer = await http.get(PARAM, headers=bearer("eyJ" + "x" * 40_000 + ".."))
        assert longer.status_code == 431
