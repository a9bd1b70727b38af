from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from issuer import Issuer, issuing
from kernel.world import CONFIG, World, world_of


@pytest.fixture
async def issuer() -> AsyncGenerator[Issuer]:
    async with issuing() as made:
        yield made


@pytest.fixture
async def world(issuer: Issuer) -> AsyncGenerator[World]:
    async with world_of(CONFIG + issuer.table()) as made:
        yield made
