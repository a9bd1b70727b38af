"""Idempotency keys are kept for a day of the gateway's time, whatever its clock shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from kernel.world import Client, kept_in, world_of
from rcp_gateway.testing import SteppedClock

pytestmark = pytest.mark.anyio
DAY = 86_400.0
WEEK = 7 * DAY


async def written(client: Client, value: float) -> dict[str, Any]:
    """Write a value under a key of its own."""
    path = "/param/limit"
    return await client.ask(type="write", path=path, body=value, idempotency_key=f"k{value}")


async def test_a_clock_that_is_set_forward_makes_no_key_forgotten(
    stepped: SteppedClock, tmp_path: Path
) -> None:
    text = kept_in(tmp_path / "store.db")
    async with world_of(text, clock=stepped.clock) as world:
        client = world.client()
        first = await written(client, 1.0)
        stepped.adjust(WEEK)  # as NTP does on a computer without a battery
        await written(client, 2.0)
        assert await again(client, 1.0) == first["body"]
        assert world.robot.values["param/limit"] == 2.0
    async with world_of(text, clock=stepped.clock) as world:
        assert await again(world.client(), 1.0) == first["body"]
        assert world.robot.values["param/limit"] == 1.5  # which it begins with


async def test_the_oldest_key_goes_first_though_the_clock_went_back(
    stepped: SteppedClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = kept_in(tmp_path / "store.db")
    async with world_of(text, clock=stepped.clock) as world:
        await written(world.client(), 1.0)
        stepped.adjust(-WEEK)
        await written(world.client(), 2.0)
    for _ in range(2):
        async with world_of(text, clock=stepped.clock) as world:
            await written(world.client(), 2.0)
            assert world.robot.values["param/limit"] == 1.5  # which it begins with
        monkeypatch.setattr("rcp_requests.idempotency._KEPT", 1)


async def again(client: Client, value: float) -> Any:
    """Repeat a write; return what it answers."""
    reply = await written(client, value)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def test_a_key_is_forgotten_after_a_day(stepped: SteppedClock) -> None:
    async with world_of(clock=stepped.clock) as world:
        client = world.client()
        await written(client, 1.0)
        await written(client, 2.0)
        stepped.advance(DAY * 1.1)
        client = world.client()
        await written(client, 1.0)
        assert world.robot.values["param/limit"] == 1.0
