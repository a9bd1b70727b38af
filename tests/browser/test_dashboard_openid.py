"""A person logs in at a real OpenID provider and comes back, and logs out at both."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path

import pytest
from playwright.async_api import Browser, Page, expect

from browser.watched import require_pages
from certs import Authority
from configuration import tls
from openid import Provider, login_table, providing
from ports import free_port
from transports.robot import Site, site

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
NAME = "House & Co"


@pytest.fixture(scope="module")
async def provider(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Provider]:
    async with providing(tmp_path_factory.mktemp("provider")) as made:
        yield made


@pytest.fixture(scope="module")
async def gateway(provider: Provider) -> AsyncGenerator[Site]:
    require_pages()
    port = free_port()
    await provider.serve(port)
    more = login_table(provider.url, port) + "\n[plugins.dashboard]\n"
    async with site(port=port, top="anonymous = false\n", more=more) as made:
        yield made


async def to_the_provider(page: Page) -> None:
    await page.get_by_role("banner").get_by_role("button", name="Log in").click()
    await page.get_by_label("Remember on this computer").check()
    await page.get_by_role("button", name=f"Log in with {NAME}").click()


async def named(page: Page, name: str) -> None:
    """Say at the provider who one is."""
    await page.get_by_placeholder("Enter any login").fill(name)
    await page.get_by_placeholder("and password").fill("any")
    await page.get_by_role("button", name="Sign-in").click()


async def test_a_login_at_the_provider_holds_in_all_tabs_and_ends_in_both_places(
    page: Page, gateway: Site, provider: Provider
) -> None:
    await page.goto(f"{gateway.url}/#/people")
    await to_the_provider(page)
    await named(page, "ann")
    await page.wait_for_url(f"{gateway.url}/#/people")
    await expect(page.get_by_test_id("principal")).to_have_text("ann")
    cookies = await page.context.cookies(gateway.url)
    (login,) = [one for one in cookies if one["name"] == f"rcp_login_{gateway.port}"]
    assert (login["httpOnly"], login["sameSite"]) == (True, "Strict")
    assert not any("oidc" in one["name"] for one in cookies)
    kept = await page.evaluate("JSON.stringify({ ...localStorage, ...sessionStorage })")
    assert "rcp.token" not in kept
    other = await page.context.new_page()
    await other.goto(gateway.url)
    await expect(other.get_by_test_id("principal")).to_have_text("ann")

    await page.get_by_role("button", name="Log out").click()
    await expect(other.get_by_role("banner").get_by_role("button", name="Log in")).to_be_visible()
    await page.get_by_role("link", name=f"Log out of {NAME} too").click()
    await page.get_by_role("button", name="Yes, sign me out").click()
    await other.bring_to_front()
    await to_the_provider(other)
    await expect(other.get_by_placeholder("Enter any login")).to_be_visible()  # it has forgotten


async def test_whoever_turns_back_is_told_so_and_may_try_again(page: Page, gateway: Site) -> None:
    await page.goto(gateway.url)
    await to_the_provider(page)
    await page.get_by_role("link", name="Cancel").click()
    await expect(page.get_by_role("main")).to_contain_text(
        f"The login was refused or cancelled at {NAME}"
    )
    await page.get_by_role("link", name=f"Log in with {NAME}").click()
    await named(page, "eve")
    await expect(page.get_by_role("main")).to_contain_text("gives eve no role on this gateway")
    await page.get_by_role("link", name="Open the gateway").click()
    await expect(page.get_by_role("heading", name="Log in required")).to_be_visible()


async def test_a_login_at_the_provider_counts_although_the_browser_has_kept_a_key(
    page: Page, gateway: Site
) -> None:
    await page.goto(gateway.url)
    await page.evaluate("localStorage.setItem('rcp.token', 'a key that was taken back')")
    await page.reload()
    await expect(page.get_by_role("banner")).to_contain_text("Refused")
    await to_the_provider(page)
    await named(page, "ann")
    await expect(page.get_by_test_id("principal")).to_have_text("ann")
    assert await page.evaluate("localStorage.getItem('rcp.token')") is None


async def test_over_tls_the_login_is_the_hosts_alone(
    browser: Browser, provider: Provider, tmp_path: Path
) -> None:
    require_pages()
    port = free_port()
    await provider.serve(port, "https")
    more = login_table(provider.url, port, scheme="https") + "\n[plugins.dashboard]\n"
    asgi = tls(Authority(tmp_path).server())
    context = await browser.new_context(ignore_https_errors=True)  # it does not know the CA
    async with site(port=port, top="anonymous = false\n", asgi=asgi, more=more) as gateway:
        page = await context.new_page()
        await page.goto(gateway.url)
        await to_the_provider(page)
        await named(page, "ann")
        await expect(page.get_by_test_id("principal")).to_have_text("ann")
        (cookie,) = [one for one in await context.cookies(gateway.url) if "rcp" in one["name"]]
        assert cookie["name"] == f"__Host-rcp_login_{port}"
        assert (cookie["secure"], cookie["sameSite"]) == (True, "Strict")
    await context.close()
