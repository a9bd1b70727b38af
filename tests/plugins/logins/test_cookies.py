"""A login in a cookie: for the gateway's own pages, and for nobody else who comes by it."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from certs import Authority
from configuration import key, tls
from rcp_kernel.errors import Forbidden, Unauthenticated
from rcp_store.tokens import TokenFile
from rcp_web.logins import login_cookie, shown_login
from transports.robot import BOUND, KEY, Site, site, until

pytestmark = pytest.mark.anyio
LOGIN = "/rcp/v1/login"
LIMIT = "/rcp/v1/context/tenant/alpha/param/limit"
WRITTEN = "/tenant/alpha/param/limit"
ADMIN = "admin-of-this-test"
LISTED = "https://listed.example"
MORE = key("boss", ADMIN, roles={"*": ["admin"]}) + "\n[limits]\nfailed_logins = 20\n"


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    """Keep one event loop for a file, so that the gateway lives as long as its tests."""
    return "asyncio"


@pytest.fixture(scope="module")
async def gateway() -> AsyncGenerator[Site]:
    async with site(top="anonymous = false\n", asgi=f'origins = ["{LISTED}"]', more=MORE) as made:
        yield made


@pytest.fixture
async def http(gateway: Site) -> AsyncGenerator[httpx.AsyncClient]:
    """A browser that has a page of the gateway open: it keeps cookies, and says whose page it is."""
    async with browser(gateway) as found:
        yield found


def browser(gateway: Site) -> httpx.AsyncClient:
    headers = {"origin": gateway.url, "sec-fetch-site": "same-origin"}
    return httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND)


async def log_in(http: httpx.AsyncClient, token: str = KEY, **more: Any) -> str:
    """Log in; return the secret in the cookie."""
    answer = await http.post(LOGIN, json={"token": token, **more})
    assert answer.status_code == 200, answer.text
    (secret,) = http.cookies.values()
    return secret


def cookie(gateway: Site, secret: str) -> dict[str, str]:
    return {"cookie": f"rcp_login_{gateway.port}={secret}"}


async def opened(gateway: Site, secret: str, origin: str | None = None) -> ClientConnection:
    """Open a WebSocket as a browser does for a page of an origin; default: the gateway's own."""
    headers = cookie(gateway, secret) | {"origin": origin or gateway.url}
    return await connect(gateway.ws, additional_headers=headers)


async def greeted(wire: ClientConnection, **body: Any) -> dict[str, Any]:
    await wire.send(json.dumps({"type": "hello", "id": "h", "body": body}))
    return json.loads(await asyncio.wait_for(wire.recv(), BOUND))


async def ended(wire: ClientConnection) -> list[dict[str, Any]]:
    """Return what is said until the gateway closes a connection."""
    said: list[dict[str, Any]] = []
    async with asyncio.timeout(BOUND):
        try:
            while True:
                said.append(json.loads(await wire.recv()))
        except ConnectionClosed:
            return said


async def test_a_browser_stays_logged_in_by_a_cookie_that_no_script_can_read(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    assert (await http.get(LOGIN)).json() == {
        "principal": None,
        "expires": None,
        "durable": True,
        "issuers": [],
        "log_out_at": None,
    }
    assert (await http.get(LIMIT)).status_code == 401
    answer = await http.post(LOGIN, json={"token": KEY, "remember": True})
    assert answer.json()["principal"] == "op"
    assert answer.headers["cache-control"] == "no-store"
    (told,) = answer.headers.get_list("set-cookie")
    assert KEY not in told
    pair, *attributes = told.split("; ")
    assert pair.startswith(f"rcp_login_{gateway.port}=rcplogin_")
    assert set(attributes) == {"Path=/", "HttpOnly", "SameSite=Strict", "Max-Age=43200"}
    assert (await http.put(LIMIT, json=1.5)).status_code == 200
    assert (await http.get(LOGIN)).json()["principal"] == "op"
    (secret,) = http.cookies.values()
    async with await opened(gateway, secret) as wire:
        assert (await greeted(wire))["body"]["principal"] == "op"


async def test_a_cookie_that_is_not_to_be_remembered_ends_with_the_browser(
    http: httpx.AsyncClient,
) -> None:
    answer = await http.post(LOGIN, json={"token": KEY})
    assert "max-age" not in answer.headers["set-cookie"].lower()


async def test_a_token_in_the_header_wins_over_the_cookie(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    secret = await log_in(http)
    headers = {"authorization": "Bearer key-of-tenant-beta"}
    assert (await http.get(LIMIT, headers=headers)).status_code == 404  # of another tenant
    assert (await http.get(LIMIT, headers={"authorization": "Bearer no"})).status_code == 401
    async with await opened(gateway, secret) as wire:
        said = await greeted(wire, token="key-of-tenant-beta")
        assert said["body"]["principal"] == "beta-only"


@pytest.mark.parametrize(
    "told",
    [
        {},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "none"},
        {"origin": "null"},
        {"origin": "https://evil.example"},
        {"origin": "http://127.0.0.1:1"},
        {"origin": "OWN", "sec-fetch-site": "same-site"},
    ],
    ids=str,
)
async def test_no_other_page_changes_anything_with_a_cookie(
    gateway: Site, http: httpx.AsyncClient, told: dict[str, str]
) -> None:
    headers = {k: gateway.url if v == "OWN" else v for k, v in told.items()}
    headers |= cookie(gateway, await log_in(http))
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND) as other:
        for answer in (
            await other.put(LIMIT, json=2.0),
            await other.post("/rcp/v1/messages", json={"type": "read", "path": "/system/status"}),
            await other.delete(LOGIN),
            await other.post(LOGIN, json={"token": KEY}),
        ):
            assert answer.status_code == 403, answer.text
            assert answer.json()["error"]["code"] == "forbidden"
            assert "set-cookie" not in answer.headers
    assert (await http.get(LOGIN)).json()["principal"] == "op"


async def test_a_listed_origin_may_use_the_gateway_but_not_the_cookie(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    secret = await log_in(http)
    headers = cookie(gateway, secret) | {"origin": LISTED}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND) as other:
        assert (await other.put(LIMIT, json=2.0)).status_code == 401
        assert (await other.get(LIMIT)).status_code == 401
        for answer in (await other.post(LOGIN, json={"token": KEY}), await other.delete(LOGIN)):
            assert answer.status_code == 403
            assert "set-cookie" not in answer.headers
            assert "access-control-allow-credentials" not in answer.headers
        bearer = {"authorization": f"Bearer {KEY}"}
        assert (await other.put(LIMIT, json=2.0, headers=bearer)).status_code == 200
    async with await opened(gateway, secret, LISTED) as wire:
        assert (await greeted(wire))["body"]["principal"] == "nobody"


@pytest.mark.parametrize("origin", ["https://evil.example", "null"])
async def test_no_other_page_opens_a_websocket_with_a_cookie(
    gateway: Site, http: httpx.AsyncClient, origin: str
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        await opened(gateway, await log_in(http), origin)
    assert refused.value.response.status_code == 403


async def test_a_websocket_that_tells_no_origin_is_not_opened_with_a_cookie(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    headers = cookie(gateway, await log_in(http))
    with pytest.raises(InvalidStatus) as refused:
        await connect(gateway.ws, additional_headers=headers)
    assert refused.value.response.status_code == 403
    assert b"pages of this gateway" in refused.value.response.body


@pytest.mark.parametrize(
    ("place", "status"), [("same-origin", 200), ("none", 200), ("same-site", 401)]
)
async def test_what_a_page_embeds_is_read_with_the_cookie_only_on_the_gateways_own_page(
    gateway: Site, http: httpx.AsyncClient, place: str, status: int
) -> None:
    """An image or a link tells no origin."""
    visit = {"sec-fetch-site": place, "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}
    headers = visit | cookie(gateway, await log_in(http))
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND) as other:
        assert (await other.get(LIMIT)).status_code == status


async def test_a_login_replaces_the_one_that_somebody_may_have_put_there(gateway: Site) -> None:
    async with browser(gateway) as attacker, browser(gateway) as victim:
        planted = await log_in(attacker, "key-of-tenant-beta")
        victim.cookies.update(attacker.cookies)
        secret = await log_in(victim)
        assert secret != planted
        assert (await victim.get(LOGIN)).json()["principal"] == "op"
        assert (await attacker.get(LOGIN)).json()["principal"] is None  # ended, not shared


async def test_two_cookies_of_one_name_count_as_none(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    secret = await log_in(http)
    name = f"rcp_login_{gateway.port}"
    headers = {"cookie": f"{name}={secret}; {name}=planted", "origin": gateway.url}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND) as other:
        assert (await other.put(LIMIT, json=1.0)).status_code == 401


async def test_a_login_ends_on_the_gateway_and_with_all_its_sessions(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    secret = await log_in(http)
    async with await opened(gateway, secret) as wire, await opened(gateway, secret) as other:
        assert (await greeted(wire))["body"]["principal"] == "op"
        assert (await greeted(other, token=KEY))["body"]["principal"] == "op"
        answer = await http.delete(LOGIN)
        assert "Max-Age=0" in answer.headers["set-cookie"]
        assert (await ended(wire))[-1]["error"]["code"] == "token_expired"
        await other.send(json.dumps({"type": "ping", "id": "p"}))  # it has the key
        assert json.loads(await asyncio.wait_for(other.recv(), BOUND))["status"] == "completed"
    headers = cookie(gateway, secret) | {"origin": gateway.url}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND) as thief:
        assert (await thief.get(LIMIT)).status_code == 401
        assert (await thief.put(LIMIT, json=1.0)).status_code == 401
        bearer = {"authorization": f"Bearer {secret}"}
        assert (await thief.get(LIMIT, headers=bearer)).status_code == 401


async def test_two_pages_of_a_login_are_one_person_with_a_session_each(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    secret = await log_in(http)
    async with await opened(gateway, secret) as page, await opened(gateway, secret) as other:
        for wire in (page, other):
            assert (await greeted(wire))["body"]["principal"] == "op"
        acquire = {"do": "acquire", "scope": "/tenant/alpha"}
        await page.send(
            json.dumps({"type": "execute", "id": "l", "path": "/system/leases", "body": acquire})
        )
        lease = json.loads(await asyncio.wait_for(page.recv(), BOUND))
        assert lease["status"] == "completed", lease
        await other.send(json.dumps({"type": "read", "id": "r", "path": "/system/leases"}))
        (seen,) = json.loads(await asyncio.wait_for(other.recv(), BOUND))["body"]
        assert seen["holder"] == "op"
        await other.send(json.dumps({"type": "write", "id": "w", "path": WRITTEN, "body": 1.0}))
        refused = json.loads(await asyncio.wait_for(other.recv(), BOUND))
        assert refused["error"]["code"] == "lease_held"


async def test_a_login_does_not_prolong_itself(gateway: Site, http: httpx.AsyncClient) -> None:
    secret = await log_in(http)
    answer = await http.post(LOGIN, json={"token": secret})
    assert answer.status_code == 403
    assert "not with another login" in answer.json()["error"]["message"]


async def test_a_login_ends_with_its_key_at_once_and_outlives_a_restart(tmp_path: Path) -> None:
    store = tmp_path / "store.db"
    granted = (("alpha", ("operator",)),)
    async with (
        site(top="anonymous = false\n", folder=tmp_path) as gateway,
        browser(gateway) as http,
    ):
        _, good = TokenFile(store).create("ann", granted, None)
        token, revoked = TokenFile(store).create("bob", granted, None)
        identities = gateway.server.gateway.identities
        await until(lambda: all(_proves(identities, key) for key in (good, revoked)))
        kept, secret = await log_in(http, good), ""
        async with browser(gateway) as other:
            secret = await log_in(other, revoked)
            async with await opened(gateway, secret) as wire:
                assert (await greeted(wire))["body"]["principal"] == "bob"
                TokenFile(store).revoke(token.id)
                assert (await ended(wire))[-1]["error"]["code"] == "token_expired"
            assert (await other.get(LIMIT)).status_code == 401
    assert kept.encode() not in written(tmp_path)
    async with site(top="anonymous = false\n", folder=tmp_path) as gateway:
        names = {}
        for one in (kept, secret):
            async with httpx.AsyncClient(
                base_url=gateway.url, headers=cookie(gateway, one), timeout=BOUND
            ) as http:
                names[one] = (await http.get(LOGIN)).json()["principal"]
        assert list(names.values()) == ["ann", None]


def written(folder: Path) -> bytes:
    return b"".join(file.read_bytes() for file in folder.iterdir())


def _proves(identities: Any, token: str) -> bool:
    try:
        return identities.known(token) is not None
    except Unauthenticated:
        return False


async def test_wrong_tokens_are_slowed_and_old_cookies_are_not_held_against_anybody() -> None:
    more = "\n[limits]\nfailed_logins = 5\n"
    async with site(top="anonymous = false\n", more=more) as gateway, browser(gateway) as http:
        old = cookie(gateway, "rcplogin_" + "x" * 43)
        for _ in range(10):
            assert (await http.get(LIMIT, headers=old)).status_code == 401
        wrong = [
            (await http.post(LOGIN, json={"token": f"guess-{n}"})).status_code for n in range(8)
        ]
        assert wrong == [401] * 5 + [429] * 3
        assert await log_in(http)


@pytest.mark.parametrize(
    "body", [b"", b"{", b"[]", b'{"token": 1}', b'{"token": "x", "more": 1}', b"\xff", b"[" * 9000]
)
async def test_a_body_that_is_no_login_is_refused_without_repeating_it(
    http: httpx.AsyncClient, body: bytes
) -> None:
    answer = await http.post(LOGIN, content=body)
    assert answer.status_code == 400
    assert '"token"' in answer.json()["error"]["remedy"]


async def test_a_body_that_is_too_long_is_refused(http: httpx.AsyncClient) -> None:
    assert (await http.post(LOGIN, content=b"x" * 100_000)).status_code == 413


async def test_over_tls_the_cookie_is_the_hosts_alone_and_never_sent_in_plain_text(
    tmp_path: Path,
) -> None:
    authority = Authority(tmp_path)
    async with (
        site(asgi=tls(authority.server())) as gateway,
        httpx.AsyncClient(
            base_url=gateway.url,
            verify=ssl.create_default_context(cafile=authority.file),
            headers={"origin": gateway.url},
        ) as http,
    ):
        answer = await http.post(LOGIN, json={"token": KEY})
        told = answer.headers["set-cookie"]
        assert told.startswith(f"__Host-rcp_login_{gateway.port}=")
        assert {"Secure", "HttpOnly", "SameSite=Strict", "Path=/"} <= set(told.split("; "))
        secret = told.partition("=")[2].partition(";")[0]
        # What another program on this machine may have planted over plain HTTP does not count.
        http.cookies.clear()
        planted = cookie(gateway, secret)
        assert (await http.get(LOGIN, headers=planted)).json()["principal"] is None


async def test_a_page_that_came_in_plain_text_from_afar_gets_no_cookie() -> None:
    asgi = 'hosts = ["robot.example"]'
    async with site(asgi=asgi) as gateway:
        headers = {"host": "robot.example", "origin": "http://robot.example"}
        async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
            answer = await http.post(LOGIN, json={"token": KEY})
            assert answer.status_code == 403
            assert "https" in answer.json()["error"]["remedy"]
        headers["origin"] = "https://robot.example"  # a proxy has added TLS
        async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
            answer = await http.post(LOGIN, json={"token": KEY})
            assert answer.headers["set-cookie"].startswith("__Host-rcp_login=")
            assert "Secure" in answer.headers["set-cookie"]


@pytest.mark.parametrize(
    ("host", "names"),
    [
        (b"localhost:8080", ["__Host-rcp_login_8080", "rcp_login_8080"]),
        (b"127.0.0.1", ["__Host-rcp_login", "rcp_login"]),
        (b"[::1]:81", ["__Host-rcp_login_81", "rcp_login_81"]),
        (b"[::1]", ["__Host-rcp_login", "rcp_login"]),
    ],
)
def test_gateways_on_other_ports_of_a_machine_have_cookies_of_their_own(
    host: bytes, names: list[str]
) -> None:
    for name in names:
        headers = [(b"host", host), (b"cookie", f"a=b; {name}=s; c".encode())]
        assert shown_login({"scheme": "http", "headers": headers}) == "s"
        secure = shown_login({"scheme": "http", "headers": headers}, secure=True)
        assert secure == ("s" if name == names[0] else None)
    both = "; ".join(f"{name}={name}" for name in reversed(names)).encode()
    found = shown_login({"scheme": "http", "headers": [(b"host", host), (b"cookie", both)]})
    assert found == names[0]  # that which only the gateway can have set


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (b"robot.example", None),
        (b"localhost.example:81", None),
        (b"[", None),
        (b"localhost", b"https://localhost"),
    ],
)
def test_a_plain_cookie_counts_only_where_the_gateway_gives_one(
    host: bytes, origin: bytes | None
) -> None:
    """Behind a proxy that adds TLS, anybody on the way or at a neighbouring host can plant one."""
    headers = [(b"host", host), (b"cookie", b"rcp_login=s; rcp_login_81=s")]
    if origin is not None:
        headers.append((b"origin", origin))
    assert shown_login({"scheme": "http", "headers": headers}) is None


def test_only_this_machine_gets_a_cookie_without_tls() -> None:
    for origin in ("http://localhost:1", "http://127.0.0.1", "http://[::1]:2"):
        assert b"Secure" not in login_cookie(origin, "s", None)[1]
    for origin in ("http://192.0.2.1", "http://localhost.example", "http://robot:80"):
        with pytest.raises(Forbidden):
            login_cookie(origin, "s", None)


async def test_a_gateway_without_the_feature_says_so() -> None:
    async with site(more="\n[features]\nlogins = false\n") as gateway, browser(gateway) as http:
        for answer in (await http.get(LOGIN), await http.post(LOGIN, json={"token": KEY})):
            assert answer.status_code == 404
            assert answer.json()["error"]["code"] == "unknown_path"


async def test_removing_a_key_from_the_configuration_ends_its_logins(gateway: Site) -> None:
    kernel = gateway.server.gateway
    before = kernel.settings.config
    async with browser(gateway) as http:
        secret = await log_in(http)
        async with await opened(gateway, secret) as wire:
            await greeted(wire)
            keys = tuple(one for one in before.keys if one.name != "op")
            kernel.reconfigure(msgspec.structs.replace(before, keys=keys))
            assert (await ended(wire))[-1]["error"]["code"] == "token_expired"
            assert (await http.get(LIMIT)).status_code == 401
    kernel.reconfigure(before)


async def test_logging_out_leaves_a_program_of_the_same_person_its_lease(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    await log_in(http)
    assert (await http.put(LIMIT, json=1.5)).status_code == 200  # it is there before the program
    headers = {"authorization": f"Bearer {KEY}"}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=BOUND) as program:
        body: dict[str, Any] = {"do": "acquire", "scope": "/tenant/alpha"}
        message = {"type": "execute", "path": "/system/leases", "body": body}
        lease = (await program.post("/rcp/v1/messages", json=message)).json()
        assert lease["status"] == "completed", lease
        assert (await http.delete(LOGIN)).status_code == 200
        (held,) = (await program.get("/rcp/v1/context/system/leases")).json()["body"]
        assert held["lease"] == lease["body"]["lease"]
        message["body"] = {"do": "release", "lease": lease["body"]["lease"]}
        released = (await program.post("/rcp/v1/messages", json=message)).json()
        assert released["status"] == "completed", released


async def test_a_login_counts_against_the_quota_of_its_principal() -> None:
    more = "\n[quotas]\n[roles.operator.quota]\nrequests = 0.001\nburst = 2\n"
    async with site(more=more) as gateway, browser(gateway) as http:
        told = [(await http.post(LOGIN, json={"token": KEY})).status_code for _ in range(3)]
        assert told == [200, 200, 429]


async def test_behind_a_proxy_a_page_in_plain_text_does_not_act_by_the_cookie_of_tls() -> None:
    async with site(asgi='hosts = ["robot.example"]') as gateway:
        headers = {"host": "robot.example", "origin": "https://robot.example"}
        async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
            told = (await http.post(LOGIN, json={"token": KEY})).headers["set-cookie"]
            headers["cookie"] = told.partition(";")[0]
            assert (await http.put(LIMIT, json=1.5, headers=headers)).status_code == 200
            headers["origin"] = "http://robot.example"
            assert (await http.put(LIMIT, json=2.0, headers=headers)).status_code == 403
            assert (await http.delete(LOGIN, headers=headers)).status_code == 403
