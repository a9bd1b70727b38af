"""A gateway with a small robot, for each test of the audit log that asks for one."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from kernel.world import World, world_of


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the gateway's event loop."""
    return "asyncio"


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    """A gateway with a robot, for one test."""
    async with world_of() as made:
        yield made
