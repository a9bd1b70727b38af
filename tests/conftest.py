"""What every test needs."""

from __future__ import annotations

import pytest
from hypothesis import settings

# How long an example takes is the machine's affair: no test is timed.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the kernel's event loop."""
    return "asyncio"
