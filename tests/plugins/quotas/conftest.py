from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from kernel.world import World, world_of
from plugins.quotas.home import SLOW, at_home


@pytest.fixture
async def slow() -> AsyncGenerator[World]:
    """Three requests, and then no more for a long time."""
    async with world_of(at_home(SLOW)) as world:
        yield world
