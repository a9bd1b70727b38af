"""What is wrong with a page for those who use it otherwise: axe, fingers, narrow screens."""

from __future__ import annotations

import asyncio

from playwright.async_api import Page

from rcp_dashboard.pages import STATIC

__all__ = ["AXE", "SMALL", "scrolls_sideways", "violations"]

AXE = STATIC.parent / "web" / "node_modules" / "axe-core" / "axe.min.js"
_LOOKS = 200  # at whether all fits
_RUN = """
async (rules) => (await axe.run(document, {
  runOnly: rules,
  resultTypes: ["violations"],
})).violations
  .filter((one) => ["serious", "critical"].includes(one.impact))
  .map((one) => [one.id, ...one.nodes.slice(0, 3).map((node) => `${node.html} ${node.failureSummary}`)].join("\\n    "))
"""
SMALL = """
() => [...document.querySelectorAll(
    "button, a.button, nav a, summary, select, input:not([type=checkbox])")]
  .filter((one) => one.checkVisibility() && one.getBoundingClientRect().width > 0)
  .filter((one) => one.getBoundingClientRect().height < 43.5)
  .map((one) => one.outerHTML.slice(0, 120))
"""
_WIDER = """
() => [document.documentElement, document.querySelector("main")]
  .some((one) => one.scrollWidth > one.clientWidth)
"""


async def violations(page: Page, rules: list[str]) -> list[str]:
    """Return what axe, which is in the page, finds serious."""
    found: list[str] = await page.evaluate(_RUN, rules)
    return found


async def scrolls_sideways(page: Page) -> bool:
    """Tell whether a page has to be scrolled sideways, once it is laid out.

    What is drawn follows the size of its place a frame later, on a busy machine after seconds.
    """
    for _ in range(_LOOKS):
        if not await page.evaluate(_WIDER):
            return False
        await asyncio.sleep(0.05)
    return True
