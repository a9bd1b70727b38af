"""A request with a body that nobody reads: a short one is skipped, and one without an end ends its connection."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path

import pytest

from transports.raw import Raw, connected
from transports.robot import BOUND, KEY, site

pytestmark = pytest.mark.anyio
CHUNK = b"1000\r\n" + bytes(4096) + b"\r\n"
PICTURE = b"\x89PNG\r\n\x1a\n"
MUCH = 32 << 20  # bytes
LIMITS = "[limits]\nmessage = 100_000\n"
STREAMS = [
    "/rcp/v1/events?path=/sensor/text",
    "/dashboard/api/camera/stream?path=/tenant/alpha/sensor/blob",
    "/dashboard/map/tiles",
    "/rcp/v1/recordings/none.mcap",
    "/rcp/v1/context/sensor/text",
    "/nothing/here",
]


def get(path: str, *more: str) -> bytes:
    head = (f"GET {path} HTTP/1.1", "Host: localhost", f"Authorization: Bearer {KEY}", *more)
    return "\r\n".join((*head, "", "")).encode()


async def flooded(raw: Raw) -> int:
    """Send chunks until the gateway closes the connection, or there have been too many; return bytes."""
    reading = asyncio.create_task(read_all(raw))
    count = 0
    with suppress(ConnectionError):
        while count < MUCH and not reading.done():
            raw.send(CHUNK * 16)
            count += len(CHUNK) * 16
            await raw.writer.drain()
            await asyncio.sleep(0)
    reading.cancel()
    return count


async def read_all(raw: Raw) -> None:
    with suppress(ConnectionError):
        while await raw.reader.read(65536):
            pass


@pytest.mark.parametrize("path", STREAMS)
async def test_a_body_without_an_end_ends_its_connection(tmp_path: Path, path: str) -> None:
    archive = tmp_path / "field.pmtiles"
    archive.write_bytes(b"PMTiles\x03" + bytes(16 << 20))
    more = f'{LIMITS}[plugins.dashboard]\ntiles = "{archive}"\n'
    async with asyncio.timeout(BOUND), site(more=more) as gateway, connected(gateway) as raw:
        gateway.robot.host.publish("sensor/blob", PICTURE)
        raw.send(get(path, "Transfer-Encoding: chunked"))
        assert (await raw.reader.readline()).startswith(b"HTTP/1.1 ")
        assert await flooded(raw) < MUCH


@pytest.mark.parametrize("path", STREAMS[:2])
async def test_a_short_body_ends_no_stream(path: str) -> None:
    more = "[plugins.dashboard]\n"
    async with asyncio.timeout(BOUND), site(more=more) as gateway, connected(gateway) as raw:
        gateway.robot.host.publish("sensor/blob", PICTURE)
        raw.send(get(path, "Content-Length: 3") + b"abc")
        assert b" 200 " in await raw.reader.readline()
        await raw.reader.readuntil(b"\r\n\r\n")
        gateway.robot.host.publish("sensor/text", "there")
        gateway.robot.host.publish("sensor/blob", b"\x89PNG\r\n\x1a\nthere")
        await raw.reader.readuntil(b"there")


async def test_what_was_answered_before_its_body_came_can_be_read() -> None:
    async with asyncio.timeout(BOUND), site(more=LIMITS) as gateway, connected(gateway) as raw:
        raw.send(get("/nothing/here", f"Content-Length: {MUCH}"))
        with suppress(ConnectionError):
            for _ in range(128):
                raw.send(bytes(65536))
                await raw.writer.drain()
        answer = await raw.reader.read()
        assert answer.startswith(b"HTTP/1.1 404")
        assert answer.endswith(b"}")
