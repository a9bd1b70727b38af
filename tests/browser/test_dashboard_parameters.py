"""The parameters of a simulated copter, as its operator edits them: found, compared, written together and read back."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, FilePayload, Locator, Page, expect

import rcp_mavlink
from browser.accessible import SMALL, scrolls_sideways, violations
from browser.machines import key_of
from browser.robots import until, value
from browser.watched import Watched, signed_in
from browser.worlds import KEY, line, world
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
PARAM = "/tenant/alpha/param"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
ABOUT = """<paramfile><vehicles><parameters name="ArduCopter">
<param humanName="Return height" name="ArduCopter:RTL_ALT" documentation="Height above home of the return flight">
<field name="Range">200 8000</field><field name="Units">cm</field></param>
<param humanName="Enable" name="FENCE_ENABLE" documentation="Whether the fence is enabled">
<values><value code="0">Disabled</value><value code="1">Enabled</value></values></param>
<param humanName="Types" name="FENCE_TYPE" documentation="Which fences are enabled">
<field name="Bitmask">0:Height,1:Circle,2:Polygon</field></param>
<param humanName="Frame" name="FRAME_CLASS" documentation="Kind of frame">
<field name="RebootRequired">True</field></param>
</parameters></vehicles></paramfile>"""
CUT = """[...document.querySelectorAll("tr[data-parameter] .name button")]
  .filter((one) => one.scrollWidth > one.clientWidth).map((one) => one.textContent)"""
"""Names that are not to be seen whole."""
TEN = {f"RC{n}_DZ": 10 + n for n in range(1, 11)}
"""Ten changes that stand beside each other."""


@pytest.fixture(scope="module")
async def url(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[str]:
    """Serve a copter with all its parameters, some of them described."""
    about = tmp_path_factory.mktemp("about") / "apm.pdef.xml"
    about.write_text(ABOUT)
    text = (
        listener()
        + table("plugins.dashboard")
        + backend("drone", use="mavlink", links=["sim:copter"], parameters=str(about))
        + table("backends.twin", warmup=0.5, noise=0)
        + key("otto", key_of("otto"), role="operator")
        + key("ada", key_of("ada"), role="admin")
        + key("gil", key_of("gil"), role="viewer")
        + key("lena", key_of("lena"), role="most")
        + role("most", rule("*", "/**"), approve=[f"{PARAM}/RC5_DZ"])
    )
    async with serve(parse(text, "test"), *rcp_mavlink.rcp_backends()) as served:
        yield next(f["url"] for f in served.server.status.transports if "url" in f)


@pytest.fixture
async def drone(url: str) -> AsyncGenerator[httpx.AsyncClient]:
    """Look at the copter past the page, as the operator; its dead zones are 0 again."""
    headers = {"authorization": f"Bearer {key_of('otto')}"}
    async with httpx.AsyncClient(base_url=url, headers=headers, timeout=60) as client:
        for name in TEN:
            await client.put(f"/rcp/v1/context{PARAM}/{name}", json=0)
        yield client


@asynccontextmanager
async def editing(browser: Browser, url: str, name: str = "otto") -> AsyncGenerator[Watched]:
    """Show the parameters of the copter, all of them read."""
    async with signed_in(browser, url, key_of(name), name) as tab:
        await tab.open("parameters")
        await expect(tab.page.get_by_test_id("parameter-count")).to_have_text("Parameters: 675")
        await expect(tab.page.get_by_role("button", name="Read again")).to_be_enabled()
        yield tab


def field(page: Page, name: str) -> Locator:
    return page.get_by_label(f"Value of {name}", exact=True)


def result(page: Page, name: str) -> Locator:
    return page.locator(f'tr[data-name="{name}"]')


async def search(page: Page, words: str) -> None:
    await page.get_by_label("Search parameters").fill(words)


async def enter(page: Page) -> None:
    """Enter ten values by keyboard alone, from row to row."""
    await search(page, "rc _dz")
    await field(page, "RC1_DZ").focus()
    for number in TEN.values():
        await page.keyboard.press("Control+a")
        await page.keyboard.type(str(number))
        await page.keyboard.press("Enter")
    await expect(page.get_by_test_id("pending")).to_contain_text("Changes pending: 10")


async def kept(robot: httpx.AsyncClient) -> dict[str, Any]:
    """Ask the vehicle itself for the ten."""
    found: dict[str, Any] = {}
    for name in TEN:
        answer = await robot.get(f"/rcp/v1/context{PARAM}/{name}", params={"fresh": "true"})
        found[name] = answer.json()["body"]
    return found


async def test_ten_changes_are_entered_by_keyboard_written_read_back_and_taken_back(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with editing(browser, url) as tab:
        page = tab.page
        await enter(page)
        await expect(page.get_by_test_id("pending")).to_contain_text("one after the other")
        assert set((await kept(drone)).values()) == {0}
        await page.get_by_role("button", name="Write 10").press("Enter")
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 10.")
        await expect(page.get_by_test_id("pending")).to_have_count(0)
        assert await kept(drone) == TEN
        await page.get_by_role("button", name="Take back what was written").press("Enter")
        await field(page, "RC2_DZ").press("Escape")
        await page.get_by_role("button", name="Write 9").press("Enter")
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 9.")
        assert await kept(drone) == {**dict.fromkeys(TEN, 0), "RC2_DZ": 12}
        await drone.put(f"/rcp/v1/context{PARAM}/RC3_DZ", json=77)  # somebody else
        await expect(field(page, "RC3_DZ")).to_have_value("77")


async def test_what_is_out_of_range_is_not_sent_and_what_is_unusual_only_after_a_question(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with editing(browser, url) as tab:
        page = tab.page
        await page.get_by_label("Group", exact=True).select_option("FENCE")
        await field(page, "FENCE_TYPE").fill("400")
        await field(page, "FENCE_ENABLE").fill("1")
        row = page.locator('tr[data-parameter="FENCE_TYPE"]')
        await expect(row.get_by_role("alert")).to_have_text("✕ Enter a number from -128 to 127.")
        await expect(page.get_by_role("button", name="Write 2")).to_be_disabled()
        await tab.open("log")  # and back: nothing that was entered is lost
        await tab.open("parameters?q=fence&group=FENCE")
        await expect(field(page, "FENCE_TYPE")).to_have_value("400")
        await field(page, "FENCE_TYPE").focus()
        detail = page.get_by_test_id("parameter-detail")
        await page.get_by_role("button", name="Undo the change of FENCE_TYPE").click()
        await detail.get_by_label("2: Polygon").uncheck()
        await expect(field(page, "FENCE_TYPE")).to_have_value("3")
        await field(page, "FENCE_ENABLE").focus()
        await detail.get_by_label("Meaning").select_option("0: Disabled")
        await expect(page.get_by_test_id("pending")).to_contain_text("Changes pending: 1")
        await search(page, "rtl_alt")
        await page.get_by_label("Group", exact=True).select_option("")
        before = await value(drone, f"{PARAM}/RTL_ALT")
        await field(page, "RTL_ALT").fill("9000")
        await expect(page.get_by_text("Outside the recommended range 200 … 8000.")).to_be_visible()
        await page.get_by_label("Show", exact=True).select_option("changed")
        await expect(page.locator("tr[data-parameter]")).to_have_count(0)
        await page.get_by_label("Show", exact=True).select_option("all")
        await expect(page.locator('tr[data-parameter="RTL_ALT"] td.default')).to_have_text("1500")
        await page.get_by_role("button", name="Write 2").click()
        dialog = page.get_by_role("dialog")
        await expect(dialog).to_contain_text("RTL_ALT (200 … 8000)")
        await dialog.get_by_role("button", name="Cancel").click()
        assert await value(drone, f"{PARAM}/RTL_ALT") == before
        await page.get_by_role("button", name="Write 2").click()
        await dialog.get_by_role("button", name="Write all the same").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 2.")
        assert await value(drone, f"{PARAM}/RTL_ALT") == 9000
        await page.get_by_label("Show", exact=True).select_option("changed")
        await expect(page.locator("tr[data-parameter]")).to_have_count(1)
        for name, old in (("RTL_ALT", before), ("FENCE_TYPE", 7)):
            await drone.put(f"/rcp/v1/context{PARAM}/{name}", json=old)


async def test_a_refusal_in_the_middle_tells_what_was_written_and_keeps_the_rest(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    lease = {"do": "acquire", "scope": f"{PARAM}/RC5_DZ", "ttl": 60, "reason": "tuning"}
    headers = {"authorization": f"Bearer {key_of('ada')}"}
    async with (
        editing(browser, url) as tab,
        httpx.AsyncClient(base_url=url, headers=headers, timeout=60) as other,
    ):
        page = tab.page
        await enter(page)
        held = (await other.post("/rcp/v1/context/system/leases", json=lease)).json()
        assert held["status"] == "completed", held
        await page.get_by_role("button", name="Write 10").click()
        await expect(page.get_by_test_id("written")).to_have_text(
            "▲ Written: 4 of 10. Refused: 1. Not written: 0. Not known: 0. Not sent: 5."
        )
        await expect(page.get_by_test_id("refusal")).to_contain_text("Someone else has control")
        await page.get_by_text("What became of each").first.click()
        await expect(result(page, "RC4_DZ")).to_have_attribute("data-outcome", "written")
        await expect(result(page, "RC5_DZ")).to_have_attribute("data-outcome", "refused")
        await expect(result(page, "RC6_DZ")).to_have_attribute("data-outcome", "unsent")
        await expect(page.get_by_test_id("pending")).to_contain_text("Changes pending: 6")
        await tab.shoot("parameters-refused")
        assert list((await kept(drone)).values()) == [11, 12, 13, 14, 0, 0, 0, 0, 0, 0]
        release = {"do": "release", "lease": held["body"]["lease"]}
        await other.post("/rcp/v1/context/system/leases", json=release)
        await page.get_by_role("button", name="Write 6").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 6.")
        assert await kept(drone) == TEN


async def test_one_that_needs_approval_waits_for_it_and_the_rest_follows(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with editing(browser, url, "lena") as tab:
        page = tab.page
        await enter(page)
        await page.get_by_role("button", name="Write 10").click()
        await page.get_by_role("button", name="Ask for approval").click()
        await expect(field(page, "RC6_DZ")).to_have_attribute("readonly", "")
        assert list((await kept(drone)).values())[3:5] == [14, 0]
        drone.headers["authorization"] = f"Bearer {key_of('ada')}"
        (waits,) = await until(drone, "/system/approvals", bool)
        answer = {"id": waits["approval"], "decision": "approve"}
        await drone.post("/rcp/v1/context/system/approvals", json=answer)
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 10.")
        assert await kept(drone) == TEN


async def test_a_file_is_compared_chosen_from_one_by_one_and_saved(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with editing(browser, url) as tab:
        page = tab.page
        text = "RC1_DZ,21\nRC2_DZ,22\nRC3_DZ,0\nMIS_TOTAL,9\nNONE_SUCH,1\nRC4_DZ,wide\n"
        given = FilePayload(name="old.param", mimeType="text/plain", buffer=text.encode())
        await page.get_by_label("Parameter file").set_input_files(given)
        compared = page.get_by_test_id("compared")
        await expect(compared).to_contain_text("Different: 3. Not on this robot: 1.")
        await expect(compared).to_contain_text("Line 6 is no parameter")
        await expect(page.locator("tr[data-parameter]")).to_have_count(3)
        await tab.shoot("parameters-compared")
        assert await page.evaluate(CUT) == []
        await page.get_by_role("button", name="Use 22 of the file for RC2_DZ").click()
        await page.get_by_role("button", name="Write 1").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 1.")
        await page.get_by_role("button", name="Use all shown").click()  # but for the counter
        await expect(page.get_by_test_id("pending")).to_contain_text("Changes pending: 1")
        await expect(field(page, "RC1_DZ")).to_have_value("21")
        await page.get_by_role("button", name="Discard all").click()
        for button, name, says in (
            ("Save as JSON", "drone.parameters.json", '"RC2_DZ": 22'),
            (".param (Mission", "drone.param", "RC2_DZ,22\n"),
            (".params (QGround", "drone.params", "1\t1\tRC2_DZ\t22\t4\n"),
        ):
            await page.get_by_test_id("parameter-files").click()
            async with page.expect_download() as saving:
                await page.get_by_role("button", name=button).click()
            saved = await saving.value
            assert saved.suggested_filename == name
            path = await saved.path()
            assert says in await asyncio.to_thread(path.read_text)
        await page.get_by_label("Parameter file").set_input_files(path)
        await expect(compared).to_contain_text("Different: 0. Not on this robot: 0.")


async def test_who_may_only_look_sees_values_and_on_a_phone_nothing_is_out_of_reach(
    browser: Browser, url: str, axe: str
) -> None:
    async with editing(browser, url, "gil") as tab:
        page = tab.page
        await page.evaluate(axe)
        await expect(page.get_by_text("Your role may read these parameters")).to_be_visible()
        await search(page, "rtl_alt")
        await expect(page.locator("[data-value]").first).to_be_visible()
        await expect(page.locator("input[data-value]")).to_have_count(0)
        assert await violations(page, RULES) == []
        await page.set_viewport_size({"width": 390, "height": 844})
        await page.get_by_role("button", name="RTL_ALT", exact=True).click()
        await expect(page.get_by_test_id("parameter-detail")).to_contain_text("200 … 8000")
        assert await violations(page, RULES) == []
        assert await page.evaluate(SMALL) == []
        assert not await scrolls_sideways(page)
        await tab.shoot("parameters-phone")


# Robots that keep whatever they are told, or refuse it when a test says so.

GAINS = [
    Resource(name=f"param/{name}", description="A gain.", value=float, atomic="gains")
    for name in ("d", "i", "p")
]
MANY = [
    Resource(name=f"param/group{n // 50}/value{n}", description="One.", value=int, live=True)
    for n in range(3000)
]


@asynccontextmanager
async def looking(browser: Browser, url: str, count: int) -> AsyncGenerator[Watched]:
    """Show the parameters of a robot of a world."""
    async with signed_in(browser, url, KEY, "wall") as tab:
        await tab.open("parameters")
        counted = tab.page.get_by_test_id("parameter-count")
        await expect(counted).to_have_text(f"Parameters: {count}")
        yield tab


async def test_parameters_of_one_group_are_written_as_one_or_not_at_all(browser: Browser) -> None:
    async with world({"arm": ("alpha", GAINS)}) as there, AsyncExitStack() as after:
        robot = there.robots["arm"]
        robot.values.update({"param/d": 0.0, "param/i": 0.0, "param/p": 0.0})
        tab = await after.enter_async_context(looking(browser, there.url, 3))
        page = tab.page

        async def refuse(_: Any) -> None:
            raise DeviceRejected("the gain makes it swing")

        robot.takes["param/i"] = refuse
        await field(page, "d").fill("0.7")
        await page.keyboard.press("Backspace")  # "0." is the present value, on the way to another
        await page.keyboard.type("5")
        for name in "ip":
            await field(page, name).fill("0.5")
        await expect(page.get_by_test_id("pending")).to_contain_text("written as one")
        await page.get_by_role("button", name="Write 3").click()
        await expect(page.get_by_test_id("written")).to_contain_text("Written: 0 of 3. Refused: 3.")
        await expect(page.get_by_test_id("refusal")).to_contain_text("the gain makes it swing")
        assert robot.together == []
        del robot.takes["param/i"]
        await page.get_by_role("button", name="Write 3").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 3.")
        assert robot.together == [{"param/d": 0.5, "param/i": 0.5, "param/p": 0.5}]
        assert robot.writes == []


async def test_a_connection_that_is_cut_while_writing_loses_no_change_and_sends_no_more(
    browser: Browser,
) -> None:
    plain = [Resource(name=f"param/{name}", description="It.", value=int) for name in "abcd"]
    async with AsyncExitStack() as after:
        there = await after.enter_async_context(world({"arm": ("alpha", plain)}))
        way = await after.enter_async_context(line(there.url))
        robot = there.robots["arm"]
        robot.values.update({f"param/{name}": 0 for name in "abcd"})
        tab = await after.enter_async_context(looking(browser, way.url, 4))
        tab.expected += ["WebSocket", "ERR_"]
        page = tab.page
        arrived, goes_on = asyncio.Event(), asyncio.Event()

        async def take(_: Any) -> None:
            arrived.set()
            await goes_on.wait()

        robot.takes["param/b"] = take
        for name in "abcd":
            await field(page, name).fill("7")
        await page.get_by_role("button", name="Write 4").click()
        async with asyncio.timeout(60):
            await arrived.wait()
        way.mute()
        way.close()
        await expect(page.locator('[data-state="waiting"]')).to_be_attached()
        goes_on.set()
        await expect(page.get_by_test_id("pending")).to_contain_text("Changes pending: 3")
        way.speak()
        told = "▲ Written: 2 of 4. Refused: 0. Not written: 0. Not known: 0. Not sent: 2."
        await expect(page.get_by_test_id("written")).to_have_text(told)
        await expect(page.get_by_test_id("pending")).to_contain_text("Changes pending: 2")
        assert [name for name, _ in robot.writes] == ["param/a", "param/b"]
        await page.get_by_role("button", name="Write 2").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 2.")


async def test_of_thousands_only_those_in_sight_are_drawn_and_followed(browser: Browser) -> None:
    async with world({"plant": ("alpha", MANY)}) as there, AsyncExitStack() as after:
        robot = there.robots["plant"]
        for one in MANY:
            robot.measure(one.name, 1)
        tab = await after.enter_async_context(looking(browser, there.url, len(MANY)))
        page = tab.page
        lines = page.locator("tr[data-parameter]")
        await expect(field(page, "group0/value0")).to_have_value("1")
        assert await lines.count() < 60
        table_ = page.get_by_role("region", name="Parameters")
        await table_.evaluate("(one) => one.scrollTo(0, one.scrollHeight)")
        await expect(field(page, "group59/value2999")).to_have_value("1")
        robot.measure("param/group59/value2999", 5)
        await expect(field(page, "group59/value2999")).to_have_value("5")
        assert await lines.count() < 60
        await page.get_by_label("Group", exact=True).select_option("group7")
        await expect(page.get_by_test_id("parameter-count")).to_have_text("Parameters: 50 of 3000")
        await expect(field(page, "group7/value350")).to_be_visible()


async def test_a_panel_of_a_layout_writes_too_but_not_while_it_is_edited(browser: Browser) -> None:
    async with world({"arm": ("alpha", GAINS)}) as there, AsyncExitStack() as after:
        robot = there.robots["arm"]
        robot.values.update({"param/d": 0.0, "param/i": 0.0, "param/p": 0.0})
        tab = await after.enter_async_context(looking(browser, there.url, 3))
        page = tab.page
        await tab.open("layout/new")
        await page.get_by_label("Panel to add").select_option("Parameters")
        await page.get_by_role("button", name="Add a panel").click()
        await expect(field(page, "p")).to_have_attribute("readonly", "")
        await page.get_by_role("button", name="Edit", exact=True).click()
        await field(page, "p").fill("2.5")
        await page.get_by_role("button", name="Write 1").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 1.")
        assert robot.writes == [("param/p", 2.5)]
