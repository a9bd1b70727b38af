"""What every test needs."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

# How long an example takes is the machine's affair: no test is timed. CI tries the same each time.
settings.register_profile("untimed", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("untimed")


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the kernel's event loop."""
    return "asyncio"
