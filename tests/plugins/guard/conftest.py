"""A gateway with a small robot, for each test of the gateway's side of the guard."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from kernel.world import World, world_of
from rcp_kernel.clock import Clock


@pytest.fixture
async def world(gateway_clock: Clock) -> AsyncGenerator[World]:
    """A gateway with a robot, for one test."""
    async with world_of(clock=gateway_clock) as made:
        yield made
