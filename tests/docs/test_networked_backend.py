"""The lift of the tutorial passes its suite, and is found again after each way of losing it."""

from __future__ import annotations

import asyncio
import re
import signal
import subprocess
import sys
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from docs.pages import DOCS
from rcp_gateway.testing import BOUND, OPERATOR, Client, Served, eventually, serve_backend

PAGE = (DOCS / "networked-backend.md").read_text(encoding="utf-8")
DEVICE, BACKEND, SUITE = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The files of the page."""
    for name, text in (("lift", DEVICE), ("rcp_lift", BACKEND), ("test_lift", SUITE)):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    return tmp_path


def test_the_suite_of_the_page_proves_the_lift(folder: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)]
    done = subprocess.run(
        [*command, "--rootdir", str(folder), "-o", "anyio_mode=auto"],
        check=False,
        capture_output=True,
        text=True,
        timeout=240,
        cwd=folder,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@contextmanager
def lift(folder: Path, port: int = 0) -> Generator[tuple[subprocess.Popen[str], int]]:
    """Run the device in a process of its own; its port."""
    command = [sys.executable, "lift.py", str(port)]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, int(process.stdout.readline())
        finally:
            process.kill()


@asynccontextmanager
async def gateway(port: int) -> AsyncGenerator[Served]:
    module: Any = ModuleType("rcp_lift")
    exec(compile(BACKEND, "networked-backend.md", "exec", dont_inherit=True), vars(module))
    async with serve_backend(module.LIFT, {"host": "127.0.0.1", "port": port}) as served:
        await comes_to(served, "ready")
        yield served


async def comes_to(served: Served, state: str) -> None:
    async def so() -> bool:
        return served.supervisor.state == state

    await eventually(so, state, 4 * BOUND)


async def height(client: Client) -> float:
    return (await client.request("read", "/tenant/t/sensor/height", body={"fresh": True}))["body"]


async def raised(client: Client) -> str:
    """Send the platform up, for seconds; return the request once it is on its way."""
    path, body = "/tenant/t/action/move_to", {"height": 2.0}
    id_ = await client.send(type="execute", path=path, body=body)
    assert (await client.reply(id_))["status"] == "accepted"

    async def rises() -> bool:
        return await height(client) > 0.01

    await eventually(rises, "it rises", BOUND)
    return id_


@pytest.mark.real_time
async def test_a_frozen_device_is_lost_and_stands_still_when_it_is_found_again(
    folder: Path,
) -> None:
    with lift(folder) as (process, port):
        async with gateway(port) as served:
            client = served.client(OPERATOR)
            moving = await raised(client)
            process.send_signal(signal.SIGSTOP)
            final = await client.final(moving, BOUND)
            assert final["status"] == "failed"
            await comes_to(served, "down")
            process.send_signal(signal.SIGCONT)
            await comes_to(served, "ready")
            stopped = await height(client)
            async with asyncio.timeout(BOUND):
                assert (await client.request("execute", "/tenant/t/service/hold"))[
                    "status"
                ] == "completed"
            assert await height(client) == pytest.approx(stopped, abs=0.2)
            assert stopped < 1.5


@pytest.mark.real_time
async def test_a_device_that_starts_anew_is_used_at_its_port_again(folder: Path) -> None:
    with lift(folder) as (process, port):
        async with gateway(port) as served:
            client = served.client(OPERATOR)
            moving = await raised(client)
            process.kill()
            assert (await client.final(moving, BOUND))["status"] == "failed"
            await comes_to(served, "down")
            process.wait(BOUND)
            with lift(folder, port):
                await comes_to(served, "ready")
                assert await height(client) < 0.2
                await raised(client)
