"""A loop leaves the event loop to others, however little there is to play."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from backends.replay.recorded import written
from rcp_recordings.reading import Recording
from rcp_replay.player import Player

pytestmark = pytest.mark.anyio
BOUND = 60.0  # s


@asynccontextmanager
async def looping(
    file: Path, *, wanted: bool
) -> AsyncGenerator[tuple[Player, asyncio.Queue[float]]]:
    """Play a recording in a loop; the queue has the time of each jump."""
    loop, jumps = asyncio.get_running_loop(), asyncio.Queue[float]()
    with file.open("rb") as opened:
        recording = Recording(opened, None)
        player = Player(
            [recording], lambda _: wanted, lambda _: None, speed=1.0, loop=True, paused=False
        )
        player.on_jump = lambda: jumps.put_nowait(loop.time())
        task = loop.create_task(player.run())
        try:
            yield player, jumps
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            player.close()


async def test_a_loop_without_anything_to_play_ends(tmp_path: Path) -> None:
    async with looping(written(tmp_path, 0.000_003, rate=1e6), wanted=False) as (player, jumps):
        await asyncio.wait_for(jumps.get(), BOUND)
        assert player.ended


async def test_a_loop_over_microseconds_is_slow(tmp_path: Path) -> None:
    async with looping(written(tmp_path, 0.000_003, rate=1e6), wanted=True) as (player, jumps):
        async with asyncio.timeout(BOUND):
            times = [await jumps.get() for _ in range(4)]
        assert times[-1] - times[0] > 0.1
        assert player.published > 0
