"""One demo for all the tests of the documentation."""

from __future__ import annotations

import time
from collections.abc import Generator
from pathlib import Path

import pytest

from docs.demo import Demo, demo, rcpctl

DRONE = "/tenant/gamma/action"
_ARMABLE = 120.0  # s until it can be armed on a busy machine


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


@pytest.fixture
def drone(live: Demo) -> Generator[Demo]:
    """The demo, once its drone can be armed; it is as it was afterwards: others want to take off with it."""
    end = time.monotonic() + _ARMABLE
    while '"ready":true' not in rcpctl(live, "read", "/tenant/gamma/sensor/prearm").stdout:
        assert time.monotonic() < end, "the drone cannot be armed"
    yield live
    landed = rcpctl(live, "execute", f"{DRONE}/land")
    assert landed.returncode == 0 or "already on the ground" in landed.stderr, landed.stderr
    guided = rcpctl(live, "execute", f"{DRONE}/set_mode", '{"mode": "GUIDED"}')
    assert guided.returncode == 0, guided.stderr
