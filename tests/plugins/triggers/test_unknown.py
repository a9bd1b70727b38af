"""What waits for a value that is gone costs nothing meanwhile."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from plugins.triggers.gateway import gateway
from rcp_gateway.testing import SteppedClock

pytestmark = pytest.mark.anyio
MOST = 50  # timers in so many turns of an idle gateway


async def test_one_that_is_due_again_waits_for_its_value_without_a_busy_loop(
    stepped: SteppedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with gateway(clock=stepped.clock) as rig:
        await rig.follow()
        rig.robot().measure("sensor/heat", 60.0)
        await rig.made(when="sensor.heat > 50", repeat=20, alarm=True)
        await rig.happened("fired")
        stepped.advance(30)  # the heat is overdue, and so is the next firing

        async def unknown() -> dict[str, Any] | None:
            row = await rig.on_robot()
            return row if row["condition"] == "unknown" else None

        assert (await rig.eventually(unknown))["state"] == "active"
        loop, timers = asyncio.get_running_loop(), list[float]()
        call_at = loop.call_at

        def counted(when: float, *args: Any, **more: Any) -> asyncio.TimerHandle:
            timers.append(when)
            return call_at(when, *args, **more)

        monkeypatch.setattr(loop, "call_at", counted)
        for _ in range(MOST * 10):
            await asyncio.sleep(0)
        assert len(timers) < MOST
        rig.robot().measure("sensor/heat", 70.0)
        assert (await rig.happened("fired"))["values"] == {"sensor.heat": 70.0}
