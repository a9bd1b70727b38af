"""A beat of its own: as often as asked, never in a heap, and gone with whoever wanted it."""

from __future__ import annotations

import asyncio
import threading
import time

from rcp_can.ticker import Ticker


async def test_it_beats_at_its_rate() -> None:
    ticker = Ticker(400.0)
    start = time.monotonic()
    with ticker.running():
        for _ in range(100):
            await ticker.beat()
        assert time.monotonic() - start > 0.2


async def test_beats_that_are_missed_are_not_made_up_for() -> None:
    ticker = Ticker(20.0)
    with ticker.running():
        await ticker.beat()
        time.sleep(0.5)  # noqa: ASYNC251  # the loop is busy, and misses ten
        start = time.monotonic()
        for _ in range(6):
            await ticker.beat()
        assert time.monotonic() - start > 0.1  # two are the most that its thread may make up for


async def test_its_thread_ends_with_it() -> None:
    with Ticker(1000.0).running():
        pass
    async with asyncio.timeout(60):
        while any(thread.name == "can 1000 Hz" for thread in threading.enumerate()):  # noqa: ASYNC110
            await asyncio.sleep(0.01)
