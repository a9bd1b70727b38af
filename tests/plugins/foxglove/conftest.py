"""A gateway with the Foxglove protocol, and an operator's viewer, for each test that asks for them."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from plugins.foxglove.rig import OPERATOR, Site, site
from plugins.foxglove.viewer import Viewer, viewing


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    async with site() as made:
        yield made


@pytest.fixture
async def viewer(gateway: Site) -> AsyncGenerator[Viewer]:
    async with viewing(gateway.url, OPERATOR) as made:
        yield made
