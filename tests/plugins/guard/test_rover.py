"""The simulated rover is frozen with the gateway's process; it must not make up for lost time."""

from __future__ import annotations

import asyncio
import signal

import pytest

from plugins.guard.bench import child

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
WINDOW = 0.5  # s that the velocity stands for
BRAKING = 1.0 / (2 * 2.5)  # m from 1 m/s at the rover's 2.5 m/s2
TICK = 0.02  # m that the rover covers in one period


@pytest.mark.parametrize("after", [0.05, 0.4])
async def test_a_rover_that_was_frozen_goes_no_further_than_its_dead_man_allows(
    after: float,
) -> None:
    async with child("rover.py") as gateway:
        await gateway.until(lambda fact: "ready" in fact)
        await gateway.ask("reply", do="drive")
        while (await gateway.ask("travelled", do="where"))["speed"] < 1.0:
            await gateway.ask("reply", do="drive")
        start = await gateway.ask("travelled", do="where")
        taken = await gateway.ask("reply", do="drive")
        await asyncio.sleep(after)
        gateway.signal(signal.SIGSTOP)
        await asyncio.sleep(2.0)
        frozen = asyncio.get_running_loop().time() - 2.0 - taken["at"]
        gateway.signal(signal.SIGCONT)
        while (found := await gateway.ask("travelled", do="where"))["speed"] > 0.0:
            pass
        way = found["travelled"] - start["travelled"]
        before = taken["at"] - start["at"]
        print(f"frozen {frozen:.2f} s after the write: {way:.3f} m")  # noqa: T201
        # It was frozen in the window: it may drive until then, one tick more, and brake.
        assert way < before + frozen + 2 * TICK + BRAKING + 0.03
        assert way < before + WINDOW + BRAKING + 0.03
