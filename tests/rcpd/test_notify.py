"""The service manager is told over a real datagram socket when the gateway is ready, turns and stops."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from configuration import listener, table
from rcpd.notify import notifying

pytestmark = pytest.mark.anyio
CONFIG = table("transports", http=False, ws=False, sse=False) + listener()


@contextmanager
def manager(address: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(address.replace("@", "\0", 1))
        heard.settimeout(30)
        yield heard


@pytest.fixture(params=["path", "abstract"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "path":
        return str(tmp_path / "notify")
    if sys.platform != "linux":
        pytest.skip("abstract sockets are Linux's own")
    return f"@rcp-test-{secrets.token_hex(8)}"


def heard_until(heard: socket.socket, wanted: str, most: int = 1000) -> list[str]:
    received: list[str] = []
    while wanted not in received and len(received) < most:
        received += heard.recv(4096).decode().splitlines()
    return received


def test_a_gateway_says_that_it_is_ready_turns_and_stops(address: str, tmp_path: Path) -> None:
    (tmp_path / "rcp.toml").write_text(CONFIG)
    environment = {**os.environ, "NOTIFY_SOCKET": address, "WATCHDOG_USEC": "200000"}
    environment.pop("WATCHDOG_PID", None)
    run = "from rcpd.cli import main; main()"
    command = [sys.executable, "-c", run, "serve", str(tmp_path / "rcp.toml")]
    with manager(address) as heard:
        process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
        try:
            assert heard_until(heard, "READY=1")
            for _ in range(3):
                heard_until(heard, "WATCHDOG=1")
            process.send_signal(signal.SIGSTOP)
            drain(heard)
            heard.settimeout(0.5)
            with pytest.raises(TimeoutError):  # a loop that stands still feeds no watchdog
                heard.recv(4096)
            heard.settimeout(30)
            process.send_signal(signal.SIGCONT)
            heard_until(heard, "WATCHDOG=1")
            process.send_signal(signal.SIGTERM)
            assert "STOPPING=1" in heard_until(heard, "STOPPING=1")
            process.communicate(timeout=60)
            assert process.returncode == 0
        finally:
            process.kill()
            process.communicate()


def drain(heard: socket.socket) -> None:
    """Take what was sent before the process stood."""
    heard.settimeout(0.2)
    until = time.monotonic() + 5
    while time.monotonic() < until:
        try:
            heard.recv(4096)
        except TimeoutError:
            return


async def test_the_watchdog_is_fed_twice_in_its_time(address: str) -> None:
    loop = asyncio.get_running_loop()
    environment = {
        "NOTIFY_SOCKET": address,
        "WATCHDOG_USEC": "100000",
        "WATCHDOG_PID": str(os.getpid()),
    }
    with manager(address) as heard:
        heard.setblocking(False)
        with notifying(loop, environment):
            started = loop.time()
            for _ in range(5):
                assert await loop.sock_recv(heard, 100) == b"WATCHDOG=1"
            assert 0.15 < loop.time() - started < 5.0


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"WATCHDOG_USEC": "100000", "WATCHDOG_PID": "1"},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": "soon"},
    ],
)
async def test_without_a_watchdog_of_ours_nothing_is_fed(environment: dict[str, str]) -> None:
    with notifying(asyncio.get_running_loop(), environment) as notifier:
        assert notifier.period is None
        notifier.send("READY=1")  # and nothing happens


async def test_a_service_manager_that_is_gone_is_no_fault(tmp_path: Path) -> None:
    environment = {"NOTIFY_SOCKET": str(tmp_path / "gone")}
    with notifying(asyncio.get_running_loop(), environment) as notifier:
        notifier.send("READY=1")
