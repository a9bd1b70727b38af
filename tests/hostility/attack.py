"""One attacker in a process of its own: sends a case from several connections until it is killed.

Run: python attack.py URL CASE WHO CONNECTIONS
"""

from __future__ import annotations

import asyncio
import os
import sys
from itertools import count
from typing import Any
from urllib.parse import urlsplit

import msgspec
from cases import CASES, KEYS, Case

_encoded = msgspec.json.encode  # a long body ten times a second, with what is left of a core
_KEPT = 64  # different messages that are sent in turns


def framed(data: bytes) -> bytes:
    """Write a masked text frame; the mask is zero, as is allowed."""
    size = len(data)
    if size < 126:
        head = bytes((0x81, 0x80 | size))
    elif size < 0x10000:
        head = bytes((0x81, 0xFE)) + size.to_bytes(2, "big")
    else:
        head = bytes((0x81, 0xFF)) + size.to_bytes(8, "big")
    return head + bytes(4) + data


class Attacker:
    """Makes the messages, and sends them."""

    def __init__(self, url: str, case: Case, who: str) -> None:
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "127.0.0.1", parts.port or 80
        self._case = case
        key = KEYS[who]  # pyright: ignore[reportArgumentType] - an argument of this script
        self._proof = f"Authorization: Bearer {key}\r\n" if key else ""
        self._numbers = count()
        self.sent = asyncio.Event()

    async def run(self) -> None:
        """Send until cancelled, over new connections where one was closed."""
        while True:
            try:
                await self._connected()
            except (OSError, asyncio.IncompleteReadError):
                await asyncio.sleep(0.01)

    async def _connected(self) -> None:
        reader, writer = await asyncio.open_connection(self._host, self._port)
        try:
            if self._case.how in ("ws", "ws-connect"):
                writer.write(self._upgrade())
                await reader.readuntil(b"\r\n\r\n")
            if self._case.how in ("connect", "ws-connect"):
                writer.write(self._next())
                self.sent.set()
                await self._some(reader)
            else:
                await self._flood(reader, writer)
        finally:
            writer.transport.abort()

    async def _flood(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        draining = asyncio.create_task(self._drain(reader))
        size = min(self._case.at_once, _KEPT)
        try:
            while not draining.done():
                for _ in range(max(1, self._case.at_once // size)):
                    writer.write(b"".join(self._next() for _ in range(size)))
                    await writer.drain()
                    self.sent.set()
                await asyncio.sleep(0)
        finally:
            draining.cancel()

    async def _drain(self, reader: asyncio.StreamReader) -> None:
        while await reader.read(1 << 20):
            pass

    async def _some(self, reader: asyncio.StreamReader) -> None:
        async with asyncio.timeout(5):
            await reader.read(65_536)

    def _upgrade(self) -> bytes:
        return (
            f"GET /rcp/v1/ws HTTP/1.1\r\nHost: {self._host}:{self._port}\r\n{self._proof}"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Protocol: rcp.v1.json\r\n\r\n"
        ).encode()

    def _next(self) -> bytes:
        made: Any = self._case.made(next(self._numbers))
        if isinstance(made, dict):
            return framed(_encoded(made))
        method, path, body, headers = made
        data = b"" if body is None else _encoded(body)
        lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        if body is not None:
            lines += f"Content-Type: application/json\r\nContent-Length: {len(data)}\r\n"
        host = f"Host: {self._host}:{self._port}\r\n"
        return f"{method} {path} HTTP/1.1\r\n{host}{self._proof}{lines}\r\n".encode() + data


async def main(url: str, name: str, who: str, connections: str) -> None:
    """Attack until killed; say when it has begun."""
    case = next(one for one in CASES if one.name == name)
    attackers = [Attacker(url, case, who) for _ in range(int(connections))]
    async with asyncio.TaskGroup() as group:
        for attacker in attackers:
            group.create_task(attacker.run())
        waiting = [group.create_task(attacker.sent.wait()) for attacker in attackers]
        await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        sys.stdout.write("begun\n")
        sys.stdout.flush()


if __name__ == "__main__":
    os.nice(19)
    asyncio.run(main(*sys.argv[1:]))
