"""No test sits out what a simulated vehicle on its own loop takes."""

from __future__ import annotations

from typing import Any

import pytest

from hurry import HURRIED


@pytest.fixture
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """Hurry, but beside what goes by the machine's clock."""
    return ("asyncio", {}) if request.node.get_closest_marker("real_time") else HURRIED
