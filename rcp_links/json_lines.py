"""JSON over TCP, one object a line: the connection of many small devices."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec

__all__ = ["JsonLines", "json_lines"]

_LONGEST = 1 << 20  # bytes of a line


class JsonLines:
    """One TCP connection that carries JSON objects, each on a line of its own."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    def send(self, message: dict[str, Any]) -> None:
        """Write a line.

        :raises ConnectionResetError: the connection is lost, which a loop may tell otherwise.
        """
        if self._writer.transport.is_closing():
            raise ConnectionResetError("the connection is closed")
        self._writer.write(msgspec.json.encode(message) + b"\n")

    async def receive(self) -> dict[str, Any]:
        """Read a line.

        :raises EOFError: the device has closed the connection.
        :raises ValueError: it is no JSON object, or longer than 1 MiB.
        """
        line = await self._reader.readline()
        if not line.endswith(b"\n"):
            raise EOFError("the device has closed the connection")
        return msgspec.json.decode(line, type=dict[str, Any])


@asynccontextmanager
async def json_lines(host: str, port: int) -> AsyncGenerator[JsonLines]:
    """Connect with a device by TCP.

    :raises OSError: it cannot be reached.
    """
    reader, writer = await asyncio.open_connection(host, port, limit=_LONGEST)
    try:
        yield JsonLines(reader, writer)
    finally:
        writer.transport.abort()  # a device that takes nothing would let a closing wait
