"""The CAN backend's tests run on python-can's virtual bus; without it they are not collected."""

from __future__ import annotations

import importlib.util

import pytest

if importlib.util.find_spec("can") is None:
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"
