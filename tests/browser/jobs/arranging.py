"""Jobs at single resources, and at pages of one's own."""

from __future__ import annotations

from playwright.async_api import expect

from browser.jobs.board import job
from browser.jobs.hands import Hands
from browser.jobs.site import ARM, Site


async def find(hands: Hands, words: str, path: str) -> None:
    """Find a resource by words and open it."""
    await hands.go("Explore")
    await hands.write(hands.page.get_by_role("searchbox", name="Search"), words)
    await hands.press(hands.page.locator(f'[data-path="{path}"]'))
    await expect(hands.page.get_by_role("heading", name=path)).to_be_visible()


@job("Read a value and write another")
async def write_value(hands: Hands, site: Site) -> None:
    page, path = hands.page, f"{ARM}/param/limit"
    await find(hands, "limit beta", path)
    form = page.get_by_test_id("ask-write")
    await hands.write(form.get_by_label("value"), "1.7")
    await hands.press(form.get_by_role("button", name="Write", exact=True))
    await expect(form.get_by_test_id("answer")).to_contain_text("completed")
    await expect(page.get_by_test_id("value")).to_contain_text("1.7")
    assert site.arm.values["param/limit"] == 1.7


@job("Execute something with an input")
async def execute(hands: Hands, site: Site) -> None:
    await find(hands, "adds one", f"{ARM}/service/add")
    form = hands.page.get_by_test_id("ask-execute")
    await hands.write(form.get_by_label("value"), "41")
    await hands.press(form.get_by_role("button", name="Execute", exact=True))
    await expect(form.locator("pre.answer")).to_have_text("42")


@job("Put a layout together and save it")
async def make_layout(hands: Hands, site: Site) -> None:
    page, name = hands.page, f"Shift of {type(hands).__name__}"
    await hands.go("Layouts")
    await hands.press(page.get_by_role("link", name="New layout"))
    await hands.choose(page.get_by_label("Panel to add"), "value")
    await hands.press(page.get_by_role("button", name="Add a panel"))
    await hands.press(hands.button("Settings of Value"))
    await hands.write(page.get_by_label("Resource"), "battery arm")
    await hands.press(
        page.get_by_role("list", name="Found for Resource").get_by_role("button").first
    )
    panel = page.get_by_role("region", name="Value · sensor/battery")
    await expect(panel).to_be_visible()
    await hands.press(page.get_by_role("button", name="Save as"))
    await hands.write(page.get_by_label("Name", exact=True), name)
    await hands.suits()
    await hands.press(page.locator("form").get_by_role("button", name="Save", exact=True))
    await expect(page.get_by_role("heading", name=name)).to_be_visible()
    await hands.go("Layouts")
    await hands.press(page.get_by_role("link", name=name))
    await expect(panel).to_be_visible()
