"""What the tests of the command line share."""

from __future__ import annotations

import pytest


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the event loop of `rcpd`."""
    return "asyncio"
