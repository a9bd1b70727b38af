"""`[jwt.login]`: what it decides, and which of it cannot work."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator, Callable
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import msgspec
import pytest

from certs import Authority
from configuration import configuration, listener, table, tls
from issuer import Issuer, issuing
from kernel.world import prepared, settled
from openid import CLIENT, SECRET, login_table
from plugins.jwt.people import BACK, BEGIN, LOGIN, TOP, back, people_logging_in
from rcp_gateway.server import prepare
from rcp_jwt import authenticator
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError
from transports.robot import BOUND, Site, site

pytestmark = pytest.mark.anyio
ALPHA = configuration(table("tenants.alpha"))


@pytest.fixture
async def issuer() -> AsyncGenerator[Issuer]:
    async with issuing() as made:
        yield made


@pytest.mark.parametrize(
    ("methods", "secret", "fields"),
    [
        (["client_secret_post"], SECRET, {"client_id": CLIENT, "client_secret": SECRET}),
        (["client_secret_basic", "client_secret_post"], SECRET, {}),
        (["none"], None, {"client_id": CLIENT}),
    ],
)
async def test_the_gateway_proves_itself_as_the_issuer_wants_it(
    methods: list[str], secret: str | None, fields: dict[str, str]
) -> None:
    async with issuing() as issuer:
        issuer.more["token_endpoint_auth_methods_supported"] = methods
        async with people_logging_in(issuer) as gateway:
            if secret is None:
                reloaded(gateway, lambda text: without(text, "client_secret"))
            async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
                assert (await back(browser, issuer)).status_code == 303
        head, form = issuer.asking[-1]
        assert {name: form[name] for name in form if name.startswith("client")} == fields
        assert ("Authorization" in head) == (not fields)


def without(text: str, key: str) -> str:
    return "\n".join(line for line in text.splitlines() if not line.startswith(key))


async def test_a_login_outlives_its_token_and_ends_with_its_table(issuer: Issuer) -> None:
    async with (
        people_logging_in(issuer) as gateway,
        httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser,
    ):
        now = int(time.time())
        assert (await back(browser, issuer, exp=now + 1)).status_code == 303
        state = (await browser.get(LOGIN)).json()
        assert state["principal"] == "ann"
        assert datetime.fromisoformat(state["expires"]).timestamp() > now + 7 * 3600
        reloaded(gateway, lambda text: text.replace('"operator"', '"viewer"'))
        logins = (await browser.get("/rcp/v1/context/system/logins")).json()["body"]
        assert [one["principal"] for one in logins] == ["ann"]
        reloaded(gateway, lambda text: text.partition("[jwt.login]")[0])
        assert (await browser.get(LOGIN)).json()["principal"] is None


async def principal(gateway: Site, secret: str) -> str | None:
    """Return whose login a secret is, as a browser with its cookie is told."""
    cookie = {"cookie": f"rcp_login_{gateway.port}={secret}"}
    async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND, headers=cookie) as browser:
        return (await browser.get(LOGIN)).json()["principal"]


def facts(gateway: Site) -> list[dict[str, Any]]:
    """Return what the health report says of the ways to prove oneself."""
    return list(gateway.server.gateway.identities.facts)


def written(folder: Path) -> bytes:
    return b"".join(file.read_bytes() for file in folder.iterdir())


async def test_logins_outlive_a_restart_unless_they_were_ended_or_their_key_is_gone(
    issuer: Issuer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secrets: list[str] = []
    async with people_logging_in(issuer, folder=tmp_path) as gateway:
        for _ in range(2):
            async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as browser:
                assert (await back(browser, issuer, email="ann@example.org")).status_code == 303
                secrets.append(next(iter(browser.cookies.values())))
        kept, ended = secrets
        headers = {"origin": gateway.url, "cookie": f"rcp_login_{gateway.port}={ended}"}
        async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as browser:
            assert (await browser.delete(LOGIN)).status_code == 200
    assert b"drivers" in written(tmp_path)
    assert b"ann@example.org" not in written(tmp_path)  # nothing decides by it
    async with people_logging_in(issuer, folder=tmp_path) as gateway:
        assert await principal(gateway, kept) == "ann"
        assert await principal(gateway, ended) is None
    monkeypatch.setattr(authenticator, "_START", 0.05)
    issuer.status = b"503 No"
    async with people_logging_in(issuer, folder=tmp_path) as gateway:
        assert await principal(gateway, kept) == "ann"  # its key was good a moment ago
        (keys,) = [fact for fact in facts(gateway) if fact["name"].startswith("jwt ")]
        assert keys["state"] == "down"
        assert "the last ones count until 20" in keys["detail"]
        store = gateway.server.gateway.store
        await settled(store)
        ((source, row),) = store.load("jwt.keys").items()
        store.put("jwt.keys", source, row | {"fetched": row["fetched"] - 86_400 * 10**9})
    async with people_logging_in(issuer, folder=tmp_path) as gateway:
        assert await principal(gateway, kept) is None  # they were fetched a day ago
    issuer.status = b"200 OK"
    issuer.add("k2")
    issuer.listed.remove("k1")
    monkeypatch.undo()
    async with people_logging_in(issuer, folder=tmp_path) as gateway:
        assert await principal(gateway, kept) is None


async def test_behind_a_proxy_that_adds_tls_the_cookies_are_the_hosts_alone(issuer: Issuer) -> None:
    issuer.more |= {"authorization_endpoint": issuer.url, "token_endpoint": issuer.url + "/token"}
    more = login_table(issuer.url, 0).replace("http://127.0.0.1:0", "https://robots.example/gw")
    asgi = 'hosts = ["robots.example"]\nroot_path = "/gw"'
    async with (
        site(top=TOP, asgi=asgi, more=more) as gateway,
        httpx.AsyncClient(base_url=gateway.url, headers={"host": "robots.example"}) as browser,
    ):
        begun = await browser.get(BEGIN)
        asked = parse_qs(urlsplit(begun.headers["location"]).query)
        assert asked["redirect_uri"] == ["https://robots.example/gw" + BACK]
        told = begun.headers["set-cookie"]
        assert told.startswith("__Host-rcp_oidc=")
        assert {"Secure", "HttpOnly", "SameSite=Lax", "Path=/"} <= set(told.split("; "))
        token = issuer.token(aud=CLIENT, nonce=asked["nonce"][0], groups=["drivers"])
        issuer.exchanged = json.dumps({"id_token": token}).encode()
        answer = await browser.get(
            BACK,
            params={"code": "c", "state": asked["state"][0]},
            headers={"cookie": told.partition(";")[0]},
        )
        assert answer.headers["location"] == "https://robots.example/gw/"
        assert answer.headers.get_list("set-cookie")[1].startswith("__Host-rcp_login=")


def reloaded(gateway: Site, change: Callable[[str], str]) -> None:
    """Change the tables of issuers in a running gateway."""
    config = gateway.server.gateway.settings.config
    text = change(login_table(config.jwt[0]["issuer"], gateway.port))
    changed = msgspec.structs.replace(config, jwt=parse(ALPHA + text, "test").jwt)
    gateway.server.gateway.reconfigure(changed, prepared(changed, []).features)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("discovery = true", 'jwks_url = "https://i.example"', "`login` needs `discovery = true`"),
        ("http://127.0.0.1:1", "http://robots.example", "`url` must be the https address"),
        ("http://127.0.0.1:1", "https://robots.example/?a=b", "`url` must be the https address"),
        ("http://127.0.0.1:1", "robots.example", "`url` must be the https address"),
        ("http://127.0.0.1:1", "https://robots.example", "not listed in"),
        ("http://127.0.0.1:1", "http://127.0.0.1:1/gw", "`root_path` is ''"),
        ('id = "house"', 'id = "The House"', "id"),
        ('id = "house"', 'id = "house"\nscopes = ["a b"]', "'a b' is not a scope"),
        ('id = "house"', 'id = "house"\nclientid = 1', "unknown key `clientid`"),
        ("[[jwt]]", "[features]\nlogins = false\n[[jwt]]", "needs the feature `logins`"),
    ],
)
def test_a_table_that_cannot_work_is_refused_with_its_place(old: str, new: str, text: str) -> None:
    text_of = login_table("https://i.example", 1)
    assert old in text_of
    with pytest.raises(ConfigError, match="jwt") as refused:
        prepare(parse(ALPHA + text_of.replace(old, new), "test"), "test")
    assert text in str(refused.value)
    assert SECRET not in str(refused.value)


def test_two_logins_have_two_ids() -> None:
    text = login_table("https://i.example", 1) + login_table("https://j.example", 1)
    with pytest.raises(ConfigError, match="is also that of"):
        prepare(parse(ALPHA + text, "test"), "test")


def test_the_address_of_a_listener_with_tls_is_https(tmp_path: Path) -> None:
    files = tls(Authority(tmp_path).server())
    text = listener() + files + table("tenants.alpha") + login_table("https://i.example", 1)
    with pytest.raises(ConfigError, match="`url` must be https, as the listener has"):
        prepare(parse(text, "test"), "test")
