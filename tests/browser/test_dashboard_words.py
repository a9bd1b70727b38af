"""The dashboard in another language and with other units: no English is left, and a stop stops."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncGenerator, Iterator
from contextlib import asynccontextmanager

import httpx
import pytest
from playwright.async_api import Browser, Page, expect

from browser.accessible import SMALL, scrolls_sideways, violations
from browser.watched import Watched, watched
from docs.demo import Demo
from rcp_dashboard.pages import STATIC

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
CATALOGUE = STATIC.parent / "web" / "words" / "de.po"
RULES = [  # nothing else depends on the language
    *(
        "label-content-name-mismatch",
        "button-name",
        "link-name",
        "label",
        "select-name",
        "html-has-lang",
    ),
    *(
        "html-lang-valid",
        "valid-lang",
        "document-title",
        "empty-heading",
        "scrollable-region-focusable",
    ),
]
PAGES = {
    "": "Übersicht",
    "fleet": "Flotte",
    "explore?path=/tenant/alpha/action/move_to": "Erkunden",
    "teleop?robot=rover-alpha": "Teleop",
    "camera": "Kamera",
    "scene": "Szene",
    "map": "Karte",
    "plot?p=/tenant/alpha/sensor/pose%23position.x": "Diagramm",
    "layout": "Layouts",
    "commands": "Befehle",
    "log": "Protokoll",
    "people": "Personen",
}
_WORDS = """
() => {
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) if (!walker.currentNode.parentElement.closest("code, pre, script, style")) found.push(walker.currentNode.data);
  for (const one of document.querySelectorAll("*"))
    for (const name of ["title", "aria-label", "placeholder", "alt"]) if (one.hasAttribute(name)) found.push(one.getAttribute(name));
  return [document.title, ...found].map((one) => one.replaceAll(/\\s+/g, " ").trim()).filter(Boolean);
}
"""

_GAPS = """
() => {
  const boxes = [...document.querySelectorAll("nav a, nav button")].filter((one) => one.checkVisibility())
    .map((one) => { const range = document.createRange(); range.selectNodeContents(one.querySelector("span")); return range.getBoundingClientRect(); });
  return boxes.slice(1).map((box, at) => box.left - boxes[at].right);
}
"""


def translated() -> Iterator[tuple[str, str]]:
    """Read the texts of the catalogue that are another text in German, with it."""
    entry = re.compile(r'^msgid (".*")\nmsgstr (".*")$', re.MULTILINE)
    for one, told in entry.findall(CATALOGUE.read_text()):
        english, german = json.loads(one), json.loads(told)
        if english and english != german:
            yield english.strip(), german.strip()


def english() -> re.Pattern[str]:
    """Match what is a text of the source, with whatever stands at its places."""
    german = {told for _, told in translated()}
    # Words with small letters may be names of the wire; what is little more than its places fits anything.
    texts = [one for one, _ in translated() if one not in german and re.search(r"[A-Z]| \w", one)]
    texts = [one for one in texts if len(re.sub(r"\{\d+\}|\W", "", one)) > 4]
    escaped = (re.sub(r"\\\{\d+\\\}", "PLACE", re.escape(one)) for one in texts)
    return re.compile("|".join(escaped).replace("PLACE", r"\S+(?: \S+)?"))


@asynccontextmanager
async def in_german(
    browser: Browser, demo: Demo, *, admin: bool = False
) -> AsyncGenerator[Watched]:
    """Open the demo's dashboard in a German browser, logged in."""
    async with watched(browser, demo.url, locale="de-DE") as tab:
        await tab.open()
        await tab.connected()
        await tab.page.get_by_role("button", name="Anmelden").first.click()
        dialog = tab.page.get_by_role("dialog")
        await dialog.get_by_label("Schlüssel oder Token").fill(demo.admin if admin else demo.key)
        await dialog.get_by_role("button", name="Anmelden").click()
        await expect(tab.page.get_by_test_id("principal")).to_have_text(re.compile("demo-"))
        yield tab


async def settled(page: Page) -> None:
    await expect(page.locator("main")).not_to_contain_text(re.compile("Lade…|Frage ab"))


async def test_no_page_has_a_word_of_english_left_and_axe_finds_nothing(
    browser: Browser, running: Demo, axe: str
) -> None:
    pattern = english()
    async with in_german(browser, running) as tab:
        await expect(tab.page.locator("html")).to_have_attribute("lang", "de")
        await tab.page.evaluate(axe)
        left: set[str] = set()
        for path, name in PAGES.items():
            await tab.open(path)
            await expect(tab.page.get_by_role("main", name=name)).to_be_visible()
            await settled(tab.page)
            told: list[str] = await tab.page.evaluate(_WORDS)
            left |= {f"{name}: {one}" for one in told if pattern.fullmatch(one)}
            left |= {f"{name}: {one}" for one in await violations(tab.page, RULES)}
        assert not left, "\n".join(sorted(left))


async def test_a_stop_and_its_reset_work_in_german(
    browser: Browser, running: Demo, robot: httpx.AsyncClient
) -> None:
    async with in_german(browser, running, admin=True) as tab:
        page = tab.page
        await expect(page.get_by_test_id("estop")).to_contain_text("NOT-HALT")
        await page.keyboard.press("F9")
        await expect(page.get_by_role("alert").get_by_text("Not-Halt")).to_be_visible()
        await expect(page.get_by_test_id("stop-progress")).to_have_text(
            re.compile(r"Roboter (stehen still|im Stillstand)\.")
        )
        stopped = (await robot.get("/rcp/v1/context/system/estop")).json()["body"]
        assert stopped["active"]
        await page.get_by_role("button", name="alle Not-Halte").press("Enter")
        await expect(page.get_by_test_id("estop-active")).to_be_hidden()


async def test_language_and_units_are_chosen_on_the_page_and_kept(
    browser: Browser, running: Demo
) -> None:
    async with watched(browser, running.url) as tab:  # of a browser that asks for English
        page = tab.page
        await tab.open()
        await tab.connected()
        assert not await fetched(page), "English needs no catalogue"
        await page.get_by_test_id("preferences").click()
        await page.get_by_role("combobox", name="Units").select_option("imperial")
        await page.get_by_test_id("preferences").click()
        await page.get_by_role("combobox", name="Language").select_option("de")
        await expect(page.get_by_role("button", name="Anmelden")).to_be_visible()
        await page.reload()
        await expect(page.get_by_role("button", name="Anmelden")).to_be_visible()
        await expect(page.locator("html")).to_have_attribute("lang", "de")
        await page.get_by_test_id("preferences").click()
        await expect(page.get_by_role("combobox", name="Einheiten")).to_have_value("imperial")
        await page.get_by_role("combobox", name="Sprache").select_option("en")
        await expect(page.get_by_role("button", name="Log in")).to_be_visible()


async def test_without_its_catalogue_the_page_is_in_english(
    browser: Browser, running: Demo
) -> None:
    async with watched(browser, running.url, locale="de-DE") as tab:
        tab.expected.append("Failed to load resource")
        await tab.page.route("**/assets/de-*.js", lambda route: route.abort())
        await tab.open()
        await tab.connected()
        await expect(tab.page.get_by_test_id("estop")).to_contain_text("STOP")
        await tab.page.get_by_test_id("preferences").click()
        await tab.page.get_by_role("combobox", name="Language").select_option("de")
        await expect(tab.page.get_by_text("The language could not be loaded")).to_be_visible()


async def test_values_are_shown_in_feet_with_the_unit_beside_them(
    browser: Browser, running: Demo
) -> None:
    script = "localStorage.setItem('rcp.units', 'imperial')"
    async with in_german(browser, running) as tab:
        await tab.page.evaluate(script)
        await tab.page.reload()
        await tab.open()
        card = tab.page.locator('[data-robot="rover-alpha"]')
        await expect(card).to_contain_text(re.compile(r"-?\d+,\d\d; -?\d+,\d\d ft"))
        await tab.open("teleop?robot=rover-alpha")
        await expect(tab.page.get_by_text("Höchstgeschwindigkeit")).to_contain_text(
            re.compile(r"\d,\d\d mph")
        )


async def test_on_a_phone_the_german_words_have_room(browser: Browser, running: Demo) -> None:
    async with watched(browser, running.url, locale="de-DE") as tab:
        await tab.page.set_viewport_size({"width": 360, "height": 740})
        await tab.open()
        await tab.connected()
        assert not await scrolls_sideways(tab.page)
        assert not await tab.page.evaluate(SMALL)
        # Of pages that the demo does not have, this one's name is the longest.
        label = tab.page.locator("nav a:visible > span:not(.visually-hidden)").last
        await label.evaluate("(one) => (one.textContent = 'Aufzeichnungen')")
        assert not await scrolls_sideways(tab.page)
        stop = await tab.page.get_by_test_id("stop-menu").bounding_box()
        assert stop is not None
        assert stop["x"] + stop["width"] <= 360
        for page in ("", "explore", "parameters", "plot", "log", "people"):
            await tab.open(page)
            await expect(tab.page.locator("nav [aria-current]")).to_be_visible()
            gaps: list[float] = await tab.page.evaluate(_GAPS)
            assert len(gaps) >= 4
            assert min(gaps) >= 4, page  # px: words that touch are read as one


async def fetched(page: Page) -> list[str]:
    """Return the catalogues that the page has asked for."""
    script = "() => performance.getEntriesByType('resource').map((one) => one.name)"
    names: list[str] = await page.evaluate(script)
    return [one for one in names if re.search(r"/assets/de-", one)]
