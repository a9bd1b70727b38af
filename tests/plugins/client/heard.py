"""The notices a client had."""

from __future__ import annotations

import asyncio

from plugins.client.gateway import BOUND
from rcp_client import Notice


class Heard:
    """Notices, and a way to wait for one."""

    def __init__(self) -> None:
        self.notices: list[Notice] = []
        self._came = asyncio.Event()

    def __call__(self, notice: Notice) -> None:
        self.notices.append(notice)
        self._came.set()

    @property
    def codes(self) -> list[str]:
        return [notice.code for notice in self.notices]

    async def until(self, code: str, times: int = 1) -> Notice:
        async with asyncio.timeout(BOUND):
            while self.codes.count(code) < times:
                self._came.clear()
                await self._came.wait()
        return [notice for notice in self.notices if notice.code == code][times - 1]
