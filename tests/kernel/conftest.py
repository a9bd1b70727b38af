"""A gateway with a small robot, for each test that asks for one."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from kernel.fenced import Clock as HeldClock
from kernel.world import World, world_of
from rcp_kernel.clock import Clock


@pytest.fixture
async def world(gateway_clock: Clock) -> AsyncGenerator[World]:
    """A gateway with a robot, for one test."""
    async with world_of(clock=gateway_clock) as made:
        yield made


@pytest.fixture
def clock() -> HeldClock:
    """The time by which changes are measured, in the test's hand."""
    return HeldClock()
