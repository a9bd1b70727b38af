"""Tests of motion limits run on the gateway's event loop."""

from __future__ import annotations

import pytest

from kernel.fenced import Clock


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the gateway's event loop."""
    return "asyncio"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The time by which changes are measured, in the test's hand."""
    return Clock(monkeypatch)
