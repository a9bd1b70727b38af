"""A gateway on a socket of its own, for each test that asks for one."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import httpx
import pytest

from transports.robot import KEY, Site, site


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    """Serve with every default."""
    async with site() as made:
        yield made


@pytest.fixture
async def http(gateway: Site) -> AsyncGenerator[httpx.AsyncClient]:
    """Call the gateway as an operator."""
    async with httpx.AsyncClient(
        base_url=gateway.url, headers={"authorization": f"Bearer {KEY}"}, timeout=20.0
    ) as client:
        yield client
