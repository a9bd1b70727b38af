"""A WebSocket written out by hand: says what no library would say."""

from __future__ import annotations

import asyncio
import base64
import json
import os
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

from transports.robot import BOUND, Site

TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10


def frame(
    opcode: int, payload: bytes = b"", *, fin: bool = True, rsv: int = 0, masked: bool = True
) -> bytes:
    """Write one frame (RFC 6455 5.2)."""
    first = (0x80 if fin else 0) | rsv << 4 | opcode
    bit = 0x80 if masked else 0
    size = len(payload)
    if size < 126:
        head = bytes((first, bit | size))
    elif size < 0x10000:
        head = bytes((first, bit | 126)) + size.to_bytes(2, "big")
    else:
        head = bytes((first, bit | 127)) + size.to_bytes(8, "big")
    if not masked:
        return head + payload
    mask = os.urandom(4)
    return head + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(payload))


class Raw:
    """One connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer
        self.head = b""

    def send(self, *frames: bytes) -> None:
        """Send bytes in one write."""
        self.writer.write(b"".join(frames))

    def ask(self, **envelope: Any) -> None:
        """Send a request as text."""
        self.send(frame(TEXT, json.dumps(envelope).encode()))

    async def frame(self) -> tuple[int, bytes]:
        """Read one frame; returns its first byte and payload."""
        async with asyncio.timeout(BOUND):
            first, size = await self.reader.readexactly(2)
            if size == 126:
                size = int.from_bytes(await self.reader.readexactly(2), "big")
            elif size == 127:
                size = int.from_bytes(await self.reader.readexactly(8), "big")
            return first, await self.reader.readexactly(size)

    async def reply(self) -> dict[str, Any]:
        """Read one text message."""
        first, payload = await self.frame()
        assert first == 0x81, (first, payload)
        return json.loads(payload)

    async def closed(self) -> int:
        """Read until the close frame; returns its code."""
        while True:
            first, payload = await self.frame()
            if first == 0x80 | CLOSE:
                return int.from_bytes(payload[:2], "big")

    async def ended(self) -> None:
        """Wait for the end of the connection."""
        async with asyncio.timeout(BOUND):
            while await self.reader.read(65_536):
                pass


def handshake(path: str = "/rcp/v1/ws", method: str = "GET", **headers: str | None) -> bytes:
    """Write an opening handshake; a header that is None is left out."""
    fields: dict[str, str | None] = {
        "Host": "127.0.0.1",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(),
    }
    fields |= {name.replace("_", "-"): value for name, value in headers.items()}
    lines = [f"{name}: {value}" for name, value in fields.items() if value is not None]
    return "\r\n".join([f"{method} {path} HTTP/1.1", *lines, "", ""]).encode()


@asynccontextmanager
async def connected(gateway: Site) -> AsyncGenerator[Raw]:
    """Open a TCP connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", gateway.port)
    try:
        yield Raw(reader, writer)
    finally:
        writer.close()


@asynccontextmanager
async def opened(gateway: Site, **headers: str | None) -> AsyncGenerator[Raw]:
    """Open a WebSocket."""
    async with connected(gateway) as raw:
        raw.send(handshake(**headers))
        async with asyncio.timeout(BOUND):
            raw.head = await raw.reader.readuntil(b"\r\n\r\n")
        assert raw.head.startswith(b"HTTP/1.1 101"), raw.head
        yield raw


async def answer(raw: Raw, request: bytes) -> tuple[int, bytes]:
    """Send bytes; return status and all that comes until the end of the connection."""
    raw.send(request)
    async with asyncio.timeout(BOUND):
        data = await raw.reader.read(-1)
    return int(data.split(b" ", 2)[1]), data
