"""A gateway that speaks A2A, for each test that asks for one."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import httpx
import pytest

from plugins.a2a.agent import agent, caller
from transports.robot import Site


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    """Serve with every default."""
    async with agent() as made:
        yield made


@pytest.fixture
async def client(gateway: Site) -> AsyncGenerator[httpx.AsyncClient]:
    """Call as the operator."""
    async with caller(gateway) as made:
        yield made
