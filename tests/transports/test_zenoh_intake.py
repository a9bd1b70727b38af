"""What a robot's gateway receives from its fleet waits for the event loop within bounds."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from rcp_zenoh.session import Intake

pytestmark = pytest.mark.anyio


def sample(size: int, priority: Any = zenoh.Priority.DATA) -> Any:
    return SimpleNamespace(payload=bytes(size), priority=priority)


async def test_what_the_loop_cannot_take_is_dropped_and_counted_but_no_stop() -> None:
    taken: list[Any] = []
    intake = Intake(asyncio.get_running_loop(), taken.append, room=100_000)
    stop = sample(100, zenoh.Priority.REAL_TIME)
    for _ in range(10):  # while the loop is busy
        intake.receive(sample(20_000))
    intake.receive(stop)
    await asyncio.sleep(0)
    assert (len(taken), intake.dropped) == (5, 6)
    assert taken[-1] is stop
    intake.receive(sample(20_000))  # there is room again
    await asyncio.sleep(0)
    assert len(taken) == 6
