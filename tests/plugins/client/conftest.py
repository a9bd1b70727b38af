"""A gateway with robots, a proxy before it, and clients that find their way only to these."""

from __future__ import annotations

import os
import subprocess
from collections.abc import AsyncGenerator, Callable, Generator
from pathlib import Path
from typing import Any

import pytest

import rcp_client
from plugins.client import rcpctl
from plugins.client.gateway import OPERATOR, Gateway
from plugins.client.proxy import Proxy
from ports import free_port
from serving import serving


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the client's event loop."""
    return "asyncio"


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Keep what this user has set up out of the tests."""
    for name in ("RCP_URL", "RCP_TOKEN", "RCP_TENANT", "RCP_CACERT", "RCP_CERT", "RCP_KEY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))


@pytest.fixture
def unused_port() -> int:
    """A port that nobody listens on."""
    return free_port()


@pytest.fixture
async def gateway() -> AsyncGenerator[Gateway]:
    async with Gateway() as made:
        yield made


@pytest.fixture
async def proxy(gateway: Gateway) -> AsyncGenerator[Proxy]:
    async with Proxy(gateway.port) as made:
        yield made


@pytest.fixture
def connect() -> Callable[..., rcp_client.Client]:
    """Make an operator's client of a gateway or proxy."""

    def made(to: Gateway | Proxy, **options: Any) -> rcp_client.Client:
        return rcp_client.connect(to.url, **{"token": OPERATOR, **options})

    return made


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Generator[str]:
    """A gateway with one simulated rover."""
    with serving(tmp_path_factory.mktemp("rcpd") / "rcp.toml", rcpctl.CONFIG) as found:
        yield found


@pytest.fixture
def run(url: str) -> Generator[rcpctl.Run]:
    """Run `rcpctl` as the operator; afterwards the rover is as it was."""
    changes = False

    def made(*arguments: str, stdin: str = "", **env: str) -> subprocess.CompletedProcess[str]:
        nonlocal changes
        changes = changes or not {"write", "execute"}.isdisjoint(arguments)
        return subprocess.run(
            [rcpctl.BIN / "rcpctl", *arguments],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=rcpctl.BOUND,
            check=False,
            env={**os.environ, "RCP_URL": url, "RCP_TOKEN": rcpctl.OPERATOR, **env},
        )

    yield made
    if changes:
        with rcp_client.Robot(url, token=rcpctl.OPERATOR) as robot:
            robot.execute("/service/clear_faults")
            robot.cancel("/action/move_to")
            robot.execute("/service/reset_system", {"pose": True})
