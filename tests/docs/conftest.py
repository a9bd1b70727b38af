"""One demo for all the tests of the documentation."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import pytest

from docs.demo import Demo, demo


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the kernel's event loop."""
    return "asyncio"


@pytest.fixture(scope="session")
def live(tmp_path_factory: pytest.TempPathFactory) -> Generator[Demo]:
    """A demo on a free port."""
    runtime: Path = tmp_path_factory.mktemp("runtime")
    with demo(runtime) as running:
        yield running
