"""Mouse, keyboard, gamepad and touch input on the dashboard, and what may interrupt it unseen."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from playwright.async_api import CDPSession, Locator, Page, expect

from browser.watched import Watched

__all__ = [
    "UNSEEN",
    "Touch",
    "drives",
    "held",
    "push",
    "shift",
    "stands",
    "take",
    "touching",
    "unsafe",
]

UNSEEN = """
window.pads = [];
navigator.getGamepads = () => window.pads;
window.hold = (axes, shoulder, mapping = "standard") => {
  const buttons = Array.from({ length: 17 }, (_, at) => ({ pressed: at === 4 && shoulder, touched: false, value: 0 }));
  window.pads = [{ id: "Test Pad (STANDARD GAMEPAD)", index: 0, connected: true, mapping, timestamp: 0, axes, buttons }];
};

window.addEventListener("pointerdown", (event) => (window.pointer = event.pointerId), true);
window.tell = (what, kind, buttons) => {
  const event = new PointerEvent(kind, { pointerId: window.pointer, buttons, bubbles: true, cancelable: true });
  return what.dispatchEvent(event);
};

window.gone = false;
document.hasFocus = () => !window.gone;
window.leave = () => ((window.gone = true), window.dispatchEvent(new Event("blur")));
window.comeBack = () => ((window.gone = false), window.dispatchEvent(new Event("focus")));

window.late = undefined;
const heard = Object.getOwnPropertyDescriptor(WebSocket.prototype, "onmessage");
Object.defineProperty(WebSocket.prototype, "onmessage", {
  set(told) {
    heard.set.call(this, (event) => (window.late ? window.late.push(() => told(event)) : told(event)));
  },
});
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
  if (window.kept && data.includes(window.hung)) window.kept.push(() => send.call(this, data));
  else send.call(this, data);
};
window.stall = () => (window.late = []);
window.hang = (hung) => ((window.hung = hung), (window.kept = []));
window.goOn = () => {
  const all = [...(window.kept ?? []), ...(window.late ?? [])];
  window.late = window.kept = undefined;
  all.forEach((one) => one());
};
"""
"""Gamepads, pointers, the focus of the window and what is late on the way, in the hands of the test."""


def unsafe(path: str) -> str:
    """Return the script for which an actuator declares no safe value."""
    return f"""
    const parse = JSON.parse;
    JSON.parse = (text) => {{
      const found = parse(text);
      for (const one of [found?.body?.resources ?? []].flat()) if (one.path === "{path}") delete one.safe;
      return found;
    }};
    """


async def take(tab: Watched, robot: str) -> Page:
    """Open Teleop for a robot and take control of it, with a key: the mouse may be busy."""
    picker = tab.page.get_by_role("combobox", name="Robot")
    if f"robot={robot}" not in tab.page.url:
        await tab.open(f"teleop?robot={robot}")
    await expect(picker).to_have_value(robot)
    await tab.page.get_by_role("button", name="Take control").press("Enter")
    await expect(tab.page.get_by_test_id("control")).to_contain_text("You have control")
    return tab.page


async def push(page: Page, button: str = "left") -> None:
    """Press the stick and push it to the left, without letting go."""
    stick = page.get_by_test_id("stick").first
    await stick.scroll_into_view_if_needed()
    box = await stick.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down(button="right" if button == "right" else "left")
    await page.mouse.move(x - box["width"] / 4, y, steps=3)


async def shift(page: Page) -> None:
    """Move the hand that is on the stick a little."""
    stick = page.get_by_test_id("stick").first
    box = await stick.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 3, box["y"] + box["height"] / 2
    await page.mouse.move(x, y - 2, steps=2)
    await page.mouse.move(x, y + 2, steps=2)


def deadman(page: Page) -> Locator:
    """Return what tells who drives."""
    return page.get_by_test_id("deadman")


async def drives(page: Page, source: str) -> None:
    """Wait until somebody drives."""
    await expect(deadman(page)).to_contain_text(source)


async def stands(page: Page) -> None:
    """Wait until nobody drives."""
    await expect(deadman(page)).to_contain_text("released")


class Touch:
    """Fingers on the page, each by its number."""

    def __init__(self, session: CDPSession) -> None:
        self._session = session
        self._at: dict[int, tuple[float, float]] = {}

    async def down(self, finger: int, x: float, y: float) -> None:
        """Put one more on the page."""
        self._at[finger] = x, y
        await self._tell("touchStart")

    async def move(self, **to: tuple[float, float]) -> None:
        """Move some at once: `a` is the first, `b` the second."""
        self._at |= {"ab".index(name): at for name, at in to.items()}
        await self._tell("touchMove")

    async def up(self, finger: int) -> None:
        """Lift one."""
        x, y = self._at.pop(finger)
        await self._send("touchEnd", [{"x": x, "y": y, "id": finger}])

    async def _tell(self, event: str) -> None:
        await self._send(event, [{"x": x, "y": y, "id": n} for n, (x, y) in self._at.items()])

    async def _send(self, event: str, points: list[dict[str, float]]) -> None:
        await self._session.send("Input.dispatchTouchEvent", {"type": event, "touchPoints": points})


@asynccontextmanager
async def touching(page: Page) -> AsyncGenerator[Touch]:
    """Touch a page while entered."""
    session = await page.context.new_cdp_session(page)
    await session.send("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 5})
    try:
        yield Touch(session)
    finally:
        await session.detach()


@asynccontextmanager
async def held(button: Locator) -> AsyncGenerator[None]:
    """Hold a button with the mouse while entered."""
    page = button.page
    await button.hover()
    await page.mouse.down()
    try:
        yield
    finally:
        await page.mouse.up()
