"""What every test needs."""

from __future__ import annotations

import pytest


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the kernel's event loop."""
    return "asyncio"
