"""People log in at a real OpenID provider, with a client that does what a browser does."""

from __future__ import annotations

import re
from collections.abc import AsyncGenerator
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

from issuer import Key
from openid import Provider, login_table, providing
from ports import free_port
from rcp_jwt import issuers
from transports.robot import BOUND, Site, site

pytestmark = pytest.mark.anyio
LOGIN = "/rcp/v1/login"
BEGIN = "/rcp/v1/login/oidc/house"
LIMIT = "/rcp/v1/context/tenant/alpha/param/limit"


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    """Keep one event loop for a file, so that the provider lives as long as its tests."""
    return "asyncio"


@pytest.fixture(scope="module")
async def provider(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Provider]:
    async with providing(tmp_path_factory.mktemp("provider")) as made:
        yield made


@pytest.fixture(scope="module")
async def gateway(provider: Provider) -> AsyncGenerator[Site]:
    port = free_port()
    await provider.serve(port)
    more = login_table(provider.url, port, "refresh = 1000\n")
    async with site(port=port, top="anonymous = false\n", more=more) as made:
        yield made


@pytest.fixture
async def browser(gateway: Site) -> AsyncGenerator[httpx.AsyncClient]:
    async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as made:
        yield made


async def at_the_provider(browser: httpx.AsyncClient, name: str, address: str) -> str:
    """Type a name at the provider; return where that sends the browser."""
    answer = await browser.get(address)
    while True:
        assert answer.is_redirect or answer.status_code == 200, answer.text
        if answer.status_code == 200:
            form = re.search(r'action="([^"]+)"', answer.text)
            assert form is not None, answer.text
            said = {"prompt": "login", "login": name, "password": "any"}
            answer = await browser.post(str(answer.url.join(form[1])), data=said)
            continue
        to = str(answer.url.join(answer.headers["location"]))
        if "/callback" in to:
            return to
        answer = await browser.get(to)


async def begun(browser: httpx.AsyncClient, **query: str) -> str:
    """Begin to log in; return where the browser goes."""
    answer = await browser.get(BEGIN, params=query)
    assert answer.status_code == 303, answer.text
    return answer.headers["location"]


async def logged_in(browser: httpx.AsyncClient, name: str = "ann", **query: str) -> httpx.Response:
    return await browser.get(await at_the_provider(browser, name, await begun(browser, **query)))


async def test_a_person_logs_in_and_acts_with_the_roles_of_the_claims(
    gateway: Site, provider: Provider, browser: httpx.AsyncClient
) -> None:
    state = (await browser.get(LOGIN)).json()
    assert state["issuers"] == [{"name": "House & Co", "url": gateway.url + BEGIN}]
    answer = await logged_in(browser, next="/#/fleet?q=a b", remember="true")
    assert answer.status_code == 303, answer.text
    assert answer.headers["location"] == gateway.url + "/#/fleet?q=a%20b"
    forgotten, told = answer.headers.get_list("set-cookie")
    assert forgotten.startswith(f"rcp_oidc_{gateway.port}=;")
    assert "Max-Age=0" in forgotten
    assert {"HttpOnly", "SameSite=Strict"} <= set(told.split("; "))
    assert int(told.partition("Max-Age=")[2]) in range(28_700, 28_831)  # `leeway` later at most
    state = (await browser.get(LOGIN)).json()
    assert state["principal"] == "ann"
    headers = {"origin": gateway.url, "sec-fetch-site": "same-origin"}
    assert (await browser.put(LIMIT, json=1.5, headers=headers)).status_code == 200
    (login,) = (await browser.get("/rcp/v1/context/system/logins")).json()["body"]
    assert (login["principal"], login["proof"]) == ("ann", f"jwt {provider.url}")
    ended = (await browser.delete(LOGIN, headers=headers)).json()
    assert ended["log_out_at"]["name"] == "House & Co"
    assert ended["log_out_at"]["url"].startswith(provider.url + "/session/end?client_id=gateway+of")
    assert (await browser.get(ended["log_out_at"]["url"])).status_code == 200
    assert (await browser.get(LIMIT)).status_code == 401


async def test_what_is_sent_to_the_provider_is_fresh_and_proves_possession(
    browser: httpx.AsyncClient,
) -> None:
    one, other = [parse_qs(urlsplit(await begun(browser)).query) for _ in range(2)]
    assert one["code_challenge_method"] == ["S256"]
    assert one["scope"] == ["openid profile"]
    for name in ("state", "nonce", "code_challenge"):
        assert len(one[name][0]) == 43
        assert one[name] != other[name]


async def test_a_person_without_a_role_is_told_so(browser: httpx.AsyncClient) -> None:
    answer = await logged_in(browser, "eve")
    assert answer.status_code == 403
    assert "The token gives eve no role on this gateway" in answer.text
    assert (await browser.get(LOGIN)).json()["principal"] is None


async def test_a_code_is_good_once(browser: httpx.AsyncClient) -> None:
    address = await begun(browser)
    started = dict(browser.cookies)
    back = await at_the_provider(browser, "ann", address)
    assert (await browser.get(back)).status_code == 303
    again = await browser.get(back)
    assert again.status_code == 403
    assert "This browser has begun no login" in again.text
    # Not even for somebody who had the cookie too.
    thief = await browser.get(back, headers={"cookie": _cookies(started)})
    assert thief.status_code == 403
    assert "This login was used already" in thief.text


def _cookies(found: dict[str, str]) -> str:
    return "; ".join(f"{name}={value}" for name, value in found.items())


async def test_a_code_counts_only_in_the_browser_that_began_the_login(
    gateway: Site, browser: httpx.AsyncClient
) -> None:
    """Somebody else's answer logs nobody in: neither into their account, nor into one's own."""
    back = await at_the_provider(browser, "ann", await begun(browser))
    async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as other:
        assert (await other.get(back)).status_code == 403
        await begun(other)
        answer = await other.get(back)
        assert answer.status_code == 403
        assert "not the answer to the login that this browser began last" in answer.text
        assert "set-cookie" not in answer.headers  # its own login is still under way
    assert (await browser.get(back)).status_code == 303


async def test_a_login_replaces_the_former_one(browser: httpx.AsyncClient) -> None:
    await logged_in(browser)
    before = dict(browser.cookies)
    await logged_in(browser)
    assert (await browser.get(LOGIN, headers={"cookie": _cookies(before)})).json()[
        "principal"
    ] is None
    assert (await browser.get(LOGIN)).json()["principal"] == "ann"


async def test_a_new_key_of_the_provider_works_at_once_and_one_taken_back_ends_its_logins(
    gateway: Site, provider: Provider, browser: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.01)
    await logged_in(browser)
    provider.keys = [Key("second", "RS256")]
    await provider.serve(gateway.port)
    async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as other:
        assert (await logged_in(other)).status_code == 303
        assert (await other.get(LOGIN)).json()["principal"] == "ann"
    assert (await browser.get(LOGIN)).json()["principal"] is None
