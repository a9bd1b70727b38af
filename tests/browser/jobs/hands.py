"""Hands of people who have a keyboard alone, or a phone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator
from contextlib import AbstractAsyncContextManager, asynccontextmanager

from playwright.async_api import Locator, Page, expect

from browser.accessible import violations
from browser.input_helpers import Touch

__all__ = ["Fingers", "Hands", "Keys"]

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
STEP = 40  # px between places that fingers choose
MOST = 400  # presses of Tab on the way to anything
_WAY = """
(wanted) => {
  const from = document.activeElement ?? document.body;
  if (from === wanted) return 0;
  const back = from !== document.body && wanted.compareDocumentPosition(from) & Node.DOCUMENT_POSITION_FOLLOWING;
  const stops = [...document.querySelectorAll("a[href], button:not(:disabled), input:not(:disabled), select, textarea, summary, [tabindex='0']")]
    .filter((one) => one.tabIndex >= 0 && one.checkVisibility({ visibilityProperty: true }));
  const between = stops.filter((one) => {
    const [low, high] = back ? [wanted, from] : [from, wanted];
    return (from === document.body || low.compareDocumentPosition(one) & Node.DOCUMENT_POSITION_FOLLOWING)
      && high.compareDocumentPosition(one) & Node.DOCUMENT_POSITION_PRECEDING;
  }).length;
  return back ? -between - 1 : between + 1;
}
"""
"""How many presses of Tab it takes from where the focus is, about; below 0 with Shift."""


class Hands(ABC):
    """What a person does with the page of the dashboard that is open."""

    def __init__(self, page: Page, axe: str) -> None:
        self.page = page
        self._axe = axe

    @abstractmethod
    async def press(self, what: Locator) -> None:
        """Press a button or a link, or tick a box."""

    @abstractmethod
    async def write(self, what: Locator, text: str) -> None:
        """Put a text into a field, in place of what is there."""

    @abstractmethod
    async def choose(self, what: Locator, value: str) -> None:
        """Choose from a list, by the value of an option."""

    @abstractmethod
    def held(self, what: Locator) -> AbstractAsyncContextManager[None]:
        """Hold a button while entered."""

    @abstractmethod
    async def point(self, chart: Locator, right: int, up: int = 0) -> None:
        """Choose a place on a map or a scene, so many steps beside its middle; keys move the middle there."""

    @abstractmethod
    async def go(self, name: str) -> None:
        """Go to a page by its name in the navigation."""

    async def suits(self) -> None:
        """Fail if the page, as it is now, is hard to use for some."""
        await self.page.evaluate(self._axe)
        assert await violations(self.page, RULES) == []

    async def arrived(self, name: str) -> None:
        """Wait until a page is there."""
        await expect(self.page.get_by_role("main", name=name)).to_be_visible()
        await expect(self.page.get_by_text("Loading…")).to_have_count(0)

    def link(self, name: str) -> Locator:
        """Return the link to a page in the navigation."""
        pages = self.page.get_by_role("navigation", name="Pages")
        return pages.locator("a").filter(has=self.page.get_by_text(name, exact=True))

    def button(self, name: str) -> Locator:
        """Return the button of just this name."""
        return self.page.get_by_role("button", name=name, exact=True)


class Keys(Hands):
    """A keyboard, and no pointer at all: the focus goes by Tab alone."""

    async def reach(self, what: Locator) -> None:
        """Go to something by Tab, as often as it takes."""
        await expect(what).to_be_visible()
        await expect(what).to_be_enabled()
        pressed = 0
        while (way := await what.evaluate(_WAY)) != 0:
            for _ in range(max(1, abs(way))):
                await self.page.keyboard.press("Tab" if way > 0 else "Shift+Tab")
                pressed += 1
            assert pressed < MOST, f"{what} is not reached by Tab"

    async def press(self, what: Locator) -> None:
        await self.reach(what)
        box = await what.evaluate("(one) => one.type === 'checkbox'")
        await self.page.keyboard.press("Space" if box else "Enter")

    async def write(self, what: Locator, text: str) -> None:
        await self.reach(what)
        await self.page.keyboard.press("Control+a")
        await self.page.keyboard.type(text)

    async def choose(self, what: Locator, value: str) -> None:
        await self.reach(what)
        index = "(one, to) => [...one.options].findIndex((each) => each.value === to) - one.selectedIndex"
        way: int = await what.evaluate(index, value)
        for _ in range(abs(way)):
            await self.page.keyboard.press("ArrowDown" if way > 0 else "ArrowUp")
        await expect(what).to_have_value(value)

    @asynccontextmanager
    async def held(self, what: Locator) -> AsyncGenerator[None]:
        await self.reach(what)
        await self.page.keyboard.down("Enter")
        try:
            yield
        finally:
            await self.page.keyboard.up("Enter")

    async def point(self, chart: Locator, right: int, up: int = 0) -> None:
        await self.reach(chart)
        for way, keys in ((right, ("ArrowRight", "ArrowLeft")), (up, ("ArrowUp", "ArrowDown"))):
            for _ in range(abs(way)):
                await self.page.keyboard.press(keys[way < 0])
        await self.page.keyboard.press("Enter")

    async def go(self, name: str) -> None:
        await self.press(self.link(name))
        await self.arrived(name)


class Fingers(Hands):
    """Fingers on a phone."""

    async def press(self, what: Locator) -> None:
        await what.tap()

    async def write(self, what: Locator, text: str) -> None:
        await what.tap()
        await what.fill(text)  # by the keyboard on the screen, or its clipboard

    async def choose(self, what: Locator, value: str) -> None:
        await what.select_option(value)  # by the list that the phone shows

    @asynccontextmanager
    async def held(self, what: Locator) -> AsyncGenerator[None]:
        async with self.slid(what, 0):
            yield

    @asynccontextmanager
    async def slid(self, what: Locator, part: float) -> AsyncGenerator[None]:
        """Hold something while entered, and slide to the right by a part of its width."""
        await expect(what).to_be_enabled()
        await what.scroll_into_view_if_needed()
        box = await what.bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        session = await self.page.context.new_cdp_session(self.page)
        touch = Touch(session)
        await touch.down(0, x, y)
        try:
            if part:
                await touch.move(a=(x + part * box["width"], y))
            yield
        finally:
            await touch.up(0)
            await session.detach()

    async def point(self, chart: Locator, right: int, up: int = 0) -> None:
        box = await chart.bounding_box()
        assert box is not None
        x, y = box["width"] / 2 + right * STEP, box["height"] / 2 - up * STEP
        await chart.tap(position={"x": x, "y": y})

    async def go(self, name: str) -> None:
        if not await self.link(name).is_visible():
            await self.page.get_by_test_id("more-pages").tap()
        await self.link(name).tap()
        await self.arrived(name)
