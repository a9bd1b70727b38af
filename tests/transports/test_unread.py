"""Clients that ask for much and take nothing: what waits for them is bounded, in bytes."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil
import pytest

from serving import serving
from transports.raw import Raw, handshake
from transports.robot import BOUND

MAP = "/tenant/alpha/sensor/map"  # 5.3 MB in JSON
MB = 1024 * 1024
CONFIG = """
[transports.asgi]
port = 0
[[backends]]
use = "sim"
name = "rover"
tenant = "alpha"
[[keys]]
name = "operator"
role = "operator"
key = "operator-operator"
[[keys]]
name = "admin"
role = "admin"
key = "admin-admin-admin"
[limits]
{limits}
"""


class Gateway:
    """A gateway in a process of its own."""

    def __init__(self, url: str) -> None:
        self.url = url
        parts = urlsplit(url)
        self.port = parts.port or 0
        self._process = next(
            child
            for child in psutil.Process().children(recursive=True)
            if any(c.laddr.port == self.port for c in child.net_connections("tcp"))
        )

    @property
    def memory(self) -> int:
        """Resident bytes."""
        return self._process.memory_info().rss

    async def metric(self, name: str) -> float:
        """Read one metric."""
        headers = {"authorization": "Bearer admin-admin-admin"}
        async with httpx.AsyncClient(base_url=self.url, headers=headers, timeout=BOUND) as client:
            text = (await client.get("/metrics")).text
        found = re.search(rf"^{name} (\S+)$", text, re.MULTILINE)
        assert found is not None, text
        return float(found[1])

    @asynccontextmanager
    async def connected(self, **headers: str) -> AsyncGenerator[Raw]:
        """Open a WebSocket that reads nothing by itself; anonymous unless a header says otherwise."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port, limit=2048)
        raw = Raw(reader, writer)
        try:
            raw.send(handshake(**headers))
            async with asyncio.timeout(BOUND):
                await reader.readuntil(b"\r\n\r\n")
            yield raw
        finally:
            writer.transport.abort()


@pytest.fixture
def limits() -> str:
    """Change what holds by default."""
    return ""


@pytest.fixture
async def gateway(tmp_path: Path, limits: str) -> AsyncGenerator[Gateway]:
    """Serve, with a map that is there."""
    for url in _serving(tmp_path, limits):
        async with httpx.AsyncClient(base_url=url, timeout=BOUND) as client:
            assert len((await client.get("/rcp/v1/context" + MAP)).content) > 5_000_000
        yield Gateway(url)


def _serving(folder: Path, limits: str) -> Generator[str]:
    with serving(folder / "rcp.toml", CONFIG.format(limits=limits)) as url:
        yield url


async def settled(gateway: Gateway) -> int:
    """Wait until nothing more comes to wait for clients; return the process's memory."""
    last, alike = -1.0, 0
    async with asyncio.timeout(BOUND):
        while alike < 3:
            now = await gateway.metric("rcp_queue_bytes")
            alike = alike + 1 if now == last else 0
            last = now
    return gateway.memory


async def test_a_hundred_unread_reads_take_the_memory_of_a_few(gateway: Gateway) -> None:
    before = gateway.memory
    async with gateway.connected() as raw:
        for number in range(100):
            raw.ask(type="read", id=str(number), path=MAP)
        grown = await settled(gateway) - before
        assert grown < 100 * MB
        # Nothing was lost: who takes them gets all of them.
        for number in range(100):
            assert (await raw.reply())["id"] == str(number)
    assert await drained(gateway)


async def drained(gateway: Gateway) -> bool:
    """Wait until nothing waits for clients."""
    async with asyncio.timeout(BOUND):
        while await gateway.metric("rcp_queue_bytes"):
            pass
    return True
