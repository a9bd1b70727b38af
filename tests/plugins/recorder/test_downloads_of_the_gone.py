"""A download ends with its client: nothing is read on for nobody."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import AsyncGenerator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from plugins.recorder.gateway import ADMIN, BOUND, Gateway, recording
from rcp_recorder.downloads import Downloads
from rcp_web.downloads import Download

pytestmark = pytest.mark.anyio

RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close sends RST


class Endless:
    """A recording without an end, which says when it is not read any more."""

    def __init__(self) -> None:
        self.begun, self.ended = asyncio.Event(), asyncio.Event()
        self.sent = 0
        self.silent = False

    async def pieces(self, _start: int, _stop: int | None) -> AsyncGenerator[bytes]:
        self.begun.set()
        try:
            if self.silent:
                await asyncio.Event().wait()
            while True:
                await asyncio.sleep(0)
                self.sent += 1
                yield bytes(65536)
        finally:
            self.ended.set()

    async def file(self, *_: Any) -> Download:
        return Download(name="a.mcap", media="application/octet-stream", pieces=self.pieces)


@pytest.fixture
def endless(monkeypatch: pytest.MonkeyPatch) -> Endless:
    made = Endless()
    monkeypatch.setattr(Downloads, "file", made.file)
    return made


async def asked(
    gateway: Gateway, more: str = "\r\n"
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    url = urlsplit(str(gateway.http.base_url))
    reader, writer = await asyncio.open_connection(url.hostname, url.port, limit=1024)
    head = f"GET /rcp/v1/recordings/a.mcap HTTP/1.1\r\nHost: {url.netloc}\r\n"
    writer.write(f"{head}Authorization: Bearer {ADMIN}\r\n{more}".encode())
    return reader, writer


@pytest.mark.parametrize("reads", [True, False])
async def test_it_ends_when_its_client_leaves(
    tmp_path: Path, endless: Endless, *, reads: bool
) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        reader, writer = await asked(gateway)
        async with asyncio.timeout(BOUND):
            assert (await reader.readline()).startswith(b"HTTP/1.1 200")
            if reads:
                await reader.readexactly(200_000)
            writer.transport.abort()
            await endless.ended.wait()


async def test_it_ends_when_its_client_resets_the_connection(
    tmp_path: Path, endless: Endless
) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        reader, writer = await asked(gateway)
        async with asyncio.timeout(BOUND):
            await reader.readline()
            sock = writer.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
            writer.transport.abort()
            await endless.ended.wait()


async def test_it_ends_before_its_first_piece(tmp_path: Path, endless: Endless) -> None:
    endless.silent = True
    async with recording(tmp_path, paths=[]) as gateway:
        _, writer = await asked(gateway)
        async with asyncio.timeout(BOUND):
            await endless.begun.wait()
            writer.transport.abort()
            await endless.ended.wait()


async def test_a_client_that_has_sent_all_and_reads_is_not_gone(
    tmp_path: Path, endless: Endless
) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        reader, writer = await asked(gateway)
        writer.write_eof()
        async with asyncio.timeout(BOUND):
            await reader.readexactly(1_000_000)
            assert not endless.ended.is_set()
            writer.transport.abort()
            await endless.ended.wait()


async def test_a_body_without_an_end_is_refused_before_anything_is_read(
    tmp_path: Path, endless: Endless
) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        reader, writer = await asked(gateway, "Transfer-Encoding: chunked\r\n\r\n")
        async with asyncio.timeout(BOUND):
            answer = asyncio.create_task(reader.readline())
            sent = 0
            with suppress(ConnectionError):
                while not answer.done():
                    writer.write(b"1000\r\n" + bytes(4096) + b"\r\n")
                    sent += 4096
                    await writer.drain()
                    await asyncio.sleep(0)
            assert (await answer).startswith(b"HTTP/1.1 413")
        assert sent < 50_000_000
        assert not endless.begun.is_set()
        writer.transport.abort()


async def test_a_body_that_means_nothing_is_no_fault(tmp_path: Path, endless: Endless) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        reader, writer = await asked(gateway, "Content-Length: 3\r\n\r\nabc")
        async with asyncio.timeout(BOUND):
            assert (await reader.readline()).startswith(b"HTTP/1.1 200")
            await reader.readexactly(200_000)
            writer.transport.abort()
            await endless.ended.wait()
