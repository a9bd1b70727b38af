"""A gateway with MCP and an operator's client, for each test that asks for them."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from plugins.mcp.rig import EVERY_TOOL, Caller, Site, caller, site


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    """Serve with every default but a short patience."""
    async with site(mcp=EVERY_TOOL + "feedback = 50.0") as made:
        yield made


@pytest.fixture
async def operator(gateway: Site) -> AsyncGenerator[Caller]:
    """Call the gateway as an operator of alpha."""
    async with caller(gateway) as made:
        yield made
