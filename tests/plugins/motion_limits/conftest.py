"""Tests of motion limits run on the gateway's event loop."""

from __future__ import annotations

import pytest


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the gateway's event loop."""
    return "asyncio"
