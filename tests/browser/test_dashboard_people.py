"""Who is logged in and for how long: in a real browser, on the page's own buttons."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.async_api import Browser, Page, Route, expect

from browser.elsewhere import elsewhere
from browser.watched import Watched, log_in, watched
from configuration import key, table
from rcp_kernel.errors import Unauthenticated
from rcp_store.tokens import TokenFile
from transports.robot import KEY, Site, site, until

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
ADMIN = "admin-of-this-test"
LIMIT = "/rcp/v1/context/tenant/alpha/param/limit"
KIM, PAT = "kim-of-this-test", "pat-of-this-test"
MORE = (
    key("boss", ADMIN, roles={"*": ["admin"]})
    + key("kim", KIM, role="operator")
    + key("pat", PAT, role="operator")
    + table("plugins.dashboard")
)
_KEPT = """
() => JSON.stringify([document.cookie, location.href, {...localStorage}, {...sessionStorage}])
"""
_STOLEN = """
async ([url, ws]) => {
  const ask = (method, body, mode) => fetch(url, {method, body, mode, credentials: "include"})
    .then((answer) => answer.text() || answer.type, () => "blocked");
  const socket = new Promise((done) => {
    const made = new WebSocket(ws);
    made.onopen = () => done("open");
    made.onerror = () => done("blocked");
  });
  return [await ask("GET", undefined, "cors"), await ask("PUT", "2.5", "cors"),
          await ask("POST", "2.5", "no-cors"), await socket];
}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("store")


@pytest.fixture(scope="module")
async def gateway(folder: Path) -> AsyncGenerator[Site]:
    async with site(top="anonymous = false\n", more=MORE, folder=folder) as made:
        yield made


@pytest.fixture
def keys(folder: Path, gateway: Site) -> TokenFile:
    return TokenFile(folder / "store.db")


def knows(gateway: Site, token: str) -> bool:
    try:
        return gateway.server.gateway.identities.known(token) is not None
    except Unauthenticated:
        return False


@asynccontextmanager
async def seat(browser: Browser, gateway: Site, token: str, name: str) -> AsyncGenerator[Watched]:
    async with watched(browser, gateway.url) as tab:
        tab.expected.append(r"status of 40\d")
        await tab.open()
        await log_in(tab.page, token)
        await expect(tab.page.get_by_test_id("principal")).to_have_text(name)
        yield tab


async def is_out(page: Page) -> None:
    await expect(page.get_by_role("heading", name="Log in required")).to_be_visible()


async def test_a_login_outlives_its_tab_and_ends_everywhere(
    browser: Browser, gateway: Site
) -> None:
    async with seat(browser, gateway, KEY, "op") as tab:
        kept = await tab.page.evaluate(_KEPT)
        assert KEY not in kept
        assert "rcplogin_" not in kept
        await tab.page.reload()
        await expect(tab.page.get_by_test_id("principal")).to_have_text("op")
        await tab.page.goto("about:blank")  # no page of the gateway is left to ask
        first, second = [await tab.page.context.new_page() for _ in range(2)]
        for page in (first, second):
            await page.goto(gateway.url)
            await expect(page.get_by_test_id("principal")).to_have_text("op")
        (stolen,) = [one["value"] for one in await first.context.cookies()]
        await first.get_by_role("button", name="Log out").click()
        await is_out(first)
        await expect(second.get_by_role("button", name="Log in").first).to_be_visible()
        await second.goto("about:blank")
        await second.goto(gateway.url)
        await is_out(second)
        cookie: Any = {"name": f"rcp_login_{gateway.port}", "value": stolen, "url": gateway.url}
        await second.context.add_cookies([cookie])  # it is worth nothing any more
        await second.reload()
        await is_out(second)


async def test_a_page_of_another_port_does_not_act_for_who_is_logged_in(
    browser: Browser, gateway: Site
) -> None:
    """Browsers send cookies to every port of a host, and count it as one site."""
    async with seat(browser, gateway, KEY, "op") as tab, elsewhere() as port:
        page = await tab.page.context.new_page()
        await page.goto(f"http://127.0.0.1:{port}/")
        found = await page.evaluate(_STOLEN, [gateway.url + LIMIT, gateway.ws])
        assert found[0] == found[1] == found[3] == "blocked"
        assert found[2] in ("blocked", "opaque")
        entry = gateway.server.gateway.registry.entries["/tenant/alpha/param/limit"]
        assert entry.latest is not None
        assert entry.latest.value == 1.0
        own = await tab.page.evaluate(_STOLEN, [gateway.url + LIMIT, gateway.ws])
        assert '"body":1.0' in own[0].replace(" ", "")
        assert own[3] == "open"


async def test_an_admin_ends_a_session_a_login_and_a_key_on_the_page(
    browser: Browser, gateway: Site, keys: TokenFile
) -> None:
    token, secret = keys.create("ann", (("alpha", ("operator",)),), None)
    await until(lambda: knows(gateway, secret))
    async with (
        seat(browser, gateway, ADMIN, "boss") as admin,
        seat(browser, gateway, PAT, "pat") as operator,
        seat(browser, gateway, secret, "ann") as ann,
    ):
        page = admin.page
        await admin.open("people")
        sessions = page.get_by_role("region", name="Sessions")
        # A slow page may have left one of pat's sessions behind when it logged in; that one is away.
        row = sessions.locator("tr").filter(has=page.get_by_text("pat", exact=True))
        row = row.filter(has_text="127.0.0.1")
        await expect(row).to_have_count(1)
        await admin.shoot("people")
        await row.get_by_role("button", name="End the session").click()
        dialog = page.get_by_role("dialog")
        await expect(dialog).to_contain_text("end the login")
        await dialog.get_by_role("button", name="Cancel").click()
        await expect(dialog).to_have_count(0)
        await expect(operator.page.get_by_test_id("principal")).to_have_text("pat")
        await row.get_by_role("button", name="End the session").click()
        await dialog.get_by_role("button", name="End session").click()
        await expect(page.get_by_test_id("ended")).to_have_text("End session: done")
        await expect(operator.page.locator("main")).to_contain_text("was ended by boss")
        await operator.page.reload()  # the login goes on
        await expect(operator.page.get_by_test_id("principal")).to_have_text("pat")

        logins = page.get_by_role("region", name="Logins")
        login = logins.locator("tr").filter(has=page.get_by_text("pat", exact=True))
        await login.get_by_role("button", name="End the login").click()
        await dialog.get_by_role("button", name="End login").click()
        await expect(page.get_by_test_id("ended")).to_have_text("End login: done")
        await is_out(operator.page)
        await operator.page.reload()
        await is_out(operator.page)
        await expect(login).to_have_count(0)

        row = page.get_by_role("region", name="Keys").locator(f'[data-key="{token.id}"]')
        await expect(row).to_contain_text("alpha: operator")
        await row.get_by_role("button", name="Revoke the key").click()
        await dialog.get_by_role("button", name="Revoke key").click()
        await expect(row).to_contain_text("revoked")
        await is_out(ann.page)
        (kept,) = [one for one in keys.every() if one.id == token.id]
        assert kept.revoked is not None


async def test_an_operator_sees_only_what_is_its_own(browser: Browser, gateway: Site) -> None:
    async with (
        seat(browser, gateway, ADMIN, "boss"),
        seat(browser, gateway, KIM, "kim") as operator,
    ):
        page = operator.page
        await operator.open("people")
        logins = page.get_by_role("region", name="Logins")
        await expect(logins.locator("tbody tr")).to_have_count(1)
        await expect(logins).to_contain_text("kim")
        await expect(page.get_by_role("region", name="Keys")).to_have_count(0)
        await logins.get_by_role("button", name="End the login").click()  # its own
        await page.get_by_role("dialog").get_by_role("button", name="End login").click()
        await is_out(page)


async def test_a_page_logs_out_of_a_login_that_it_does_not_know_of(
    browser: Browser, gateway: Site
) -> None:
    """A tab may connect by a cookie that another one has got after it was opened."""

    async def unanswered(route: Route) -> None:
        await (route.abort() if route.request.method == "GET" else route.continue_())

    async with seat(browser, gateway, KEY, "op") as tab:
        page = await tab.page.context.new_page()
        await page.route("**/rcp/v1/login", unanswered)
        await page.goto(gateway.url)
        await expect(page.get_by_test_id("principal")).to_have_text("op")
        await page.get_by_role("button", name="Log out").click()
        await is_out(page)
        await is_out(tab.page)
        await page.unroute("**/rcp/v1/login")
        await page.reload()
        await is_out(page)


async def test_a_key_that_is_refused_is_kept_nowhere(browser: Browser, gateway: Site) -> None:
    async with watched(browser, gateway.url) as tab:
        tab.expected.append(r"status of 40\d")
        page = tab.page
        await tab.open()
        await page.get_by_role("button", name="Log in").first.click()
        dialog = page.get_by_role("dialog")
        await dialog.get_by_label("Key or token").fill("no-key-of-anybody")
        await dialog.get_by_label("Remember").check()
        await dialog.get_by_role("button", name="Log in").click()
        await expect(dialog.get_by_role("alert")).to_contain_text("valid key or token")
        assert "no-key-of-anybody" not in await page.evaluate(_KEPT)
