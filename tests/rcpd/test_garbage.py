"""Garbage is looked for only while nothing moves."""

from __future__ import annotations

import asyncio
import gc

import pytest

from rcpd.garbage import collected_at_rest

pytestmark = pytest.mark.anyio


async def test_everything_is_looked_through_only_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcpd.garbage._LOOK", 0.001)
    moving, looks, collected = True, 0, asyncio.Event()
    unmoved = asyncio.Event()

    def moves() -> bool:
        nonlocal looks
        looks += 1
        if looks == 50:
            unmoved.set()
        return moving

    def told(phase: str, facts: dict[str, int]) -> None:
        if phase == "start" and facts["generation"] == 2:
            collected.set()

    before = gc.get_threshold()
    with collected_at_rest(asyncio.get_running_loop(), moves):
        assert gc.get_freeze_count() > 0
        gc.callbacks.append(told)
        try:
            async with asyncio.timeout(60):
                await unmoved.wait()
                assert not collected.is_set()
                moving = False
                await collected.wait()
        finally:
            gc.callbacks.remove(told)
    assert (gc.get_threshold(), gc.get_freeze_count()) == (before, 0)
