"""Clients that ask for much and take nothing: what waits for them is bounded, in bytes."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncGenerator, Generator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import psutil
import pytest

from serving import ROVER, serving
from transports.raw import TEXT, Raw, frame, handshake
from transports.robot import BOUND

MAP = "/tenant/alpha/sensor/map"  # 5.3 MB in JSON
MB = 1024 * 1024


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
        found = re.search(rf"^{re.escape(name)} (\S+)$", text, re.MULTILINE)
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
    with serving(folder / "rcp.toml", f"{ROVER}[limits]\n{limits}\n") as url:
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


async def drained(gateway: Gateway) -> bool:
    """Wait until nothing waits for clients."""
    async with asyncio.timeout(BOUND):
        while await gateway.metric("rcp_queue_bytes"):
            pass
    return True


async def taken(raw: Raw, *ids: str) -> dict[str, Any]:
    """Read the final replies to some requests."""
    found: dict[str, Any] = {}
    while len(found) < len(ids):
        reply = await raw.reply()
        if reply.get("id") in ids and reply["status"] not in ("accepted", "pending"):
            found[reply["id"]] = reply
    return found


def stop(raw: Raw) -> None:
    raw.ask(type="execute", id="stop", path="/system/estop", body={}, deadline=5)


async def test_a_hundred_unread_reads_take_the_memory_of_a_few(gateway: Gateway) -> None:
    before = gateway.memory
    async with gateway.connected() as raw:
        for number in range(100):
            raw.ask(type="read", id=str(number), path=MAP)
        assert await settled(gateway) - before < 60 * MB
        # Nothing was lost: who takes them gets all of them.
        for number in range(100):
            assert (await raw.reply())["id"] == str(number)
    assert await drained(gateway)


@pytest.mark.parametrize("segment_size", [65_536, 1_048_576])
async def test_unread_segments_take_the_memory_of_a_few_messages(
    gateway: Gateway, segment_size: int
) -> None:
    before = gateway.memory
    async with gateway.connected() as raw:
        raw.ask(type="hello", id="h", body={"segment_size": segment_size})
        for number in range(100):
            raw.ask(type="read", id=str(number), path=MAP)
        assert await settled(gateway) - before < 60 * MB
        assert await gateway.metric("rcp_queue_bytes") < 32 * MB
    assert await drained(gateway)


async def test_replies_that_come_late_to_a_full_queue_say_that_it_is_full(
    gateway: Gateway,
) -> None:
    """What was asked for before the queue was full, and is answered when it is."""
    before = gateway.memory
    ids = [str(number) for number in range(100)]
    asked = [{"type": "read", "id": id_, "path": MAP, "body": {"fresh": True}} for id_ in ids]
    async with gateway.connected() as raw:
        raw.send(*(frame(TEXT, json.dumps(one).encode()) for one in asked))
        assert await settled(gateway) - before < 200 * MB
        found = await taken(raw, *ids)
    errors = [found[id_]["error"] for id_ in ids if "error" in found[id_]]
    assert {error["code"] for error in errors} == {"queue_full"}
    assert all(error["retryable"] and error["retry_after"] for error in errors)
    assert 0 < len(errors) < len(ids)
    assert await gateway.metric('rcp_queue_full_total{action="refused"}') == len(errors)
    assert await drained(gateway)


@pytest.mark.parametrize("limits", ["queue_bytes_total = 20_000_000"])
async def test_clients_that_take_nothing_leave_room_for_who_wants_to_stop_a_robot(
    gateway: Gateway,
) -> None:
    operator = {"authorization": "Bearer operator-operator"}
    async with AsyncExitStack() as stack:

        async def greedy(**headers: str) -> Raw:
            raw = await stack.enter_async_context(gateway.connected(**headers))
            for number in range(3):
                raw.ask(type="read", id=str(number), path=MAP)
            return raw

        await greedy(**operator)
        for _ in range(11):
            await greedy()
        assert 20_000_000 <= await gateway.metric("rcp_queue_bytes") < 40 * MB
        own = await stack.enter_async_context(gateway.connected(**operator))
        own.ask(type="read", id="map", path=MAP)
        told = (await taken(own, "map"))["map"]["error"]
        assert (told["code"], told["retryable"]) == ("queue_full", True)
        stop(own)
        assert (await taken(own, "stop"))["stop"]["status"] == "completed"
        # They go that hold most and take nothing, until there is room.
        async with asyncio.timeout(BOUND):
            while await gateway.metric("rcp_queue_bytes") >= 20_000_000:
                pass
        assert await gateway.metric('rcp_queue_full_total{action="closed"}') >= 1
        own.ask(type="read", id="again", path=MAP)
        assert (await taken(own, "again"))["again"]["status"] == "completed"
    assert await drained(gateway)


@pytest.mark.parametrize("limits", ["queue_bytes_total = 20_000_000"])
async def test_answers_over_http_that_nobody_takes_count_too(gateway: Gateway) -> None:
    get = b"GET /rcp/v1/context%b HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" % MAP.encode()
    async with AsyncExitStack() as stack:
        kept: list[Any] = []  # what is let go of is closed
        for _ in range(12):
            reader, writer = await asyncio.open_connection("127.0.0.1", gateway.port, limit=2048)
            stack.callback(writer.transport.abort)
            kept.append((reader, writer))
            writer.write(get * 3)
        async with asyncio.timeout(BOUND):
            while await gateway.metric("rcp_queue_bytes") < 20_000_000:
                pass
        assert await gateway.metric("rcp_queue_bytes") < 40 * MB
        async with httpx.AsyncClient(base_url=gateway.url, timeout=BOUND) as client:
            pose = await client.get("/rcp/v1/context/tenant/alpha/sensor/pose")
            assert pose.status_code == 200
            full = await client.get("/rcp/v1/context" + MAP)
            assert (full.status_code, full.json()["error"]["code"]) == (503, "queue_full")
            assert int(full.headers["retry-after"]) >= 1
    assert await drained(gateway)
