"""Fingers on a page, as a touch screen tells of them."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from playwright.async_api import CDPSession, Page

__all__ = ["Fingers", "fingers"]


class Fingers:
    """Those that lie on the page, each by its number."""

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
async def fingers(page: Page) -> AsyncGenerator[Fingers]:
    """Touch a page while entered."""
    session = await page.context.new_cdp_session(page)
    await session.send("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 5})
    try:
        yield Fingers(session)
    finally:
        await session.detach()
