"""A gateway with a small robot, for each test that asks for one."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from kernel.fenced import Clock
from kernel.world import World, world_of


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    """A gateway with a robot, for one test."""
    async with world_of() as made:
        yield made


@pytest.fixture
def clock() -> Clock:
    """The time by which changes are measured, in the test's hand."""
    return Clock()
