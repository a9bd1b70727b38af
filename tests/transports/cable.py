"""A TCP proxy between a robot and its router, which breaks, freezes and slows."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress

__all__ = ["Cable"]

_PIECE = 16_384  # bytes passed on at once


class _Wire:
    """One connection through the cable."""

    def __init__(self, *writers: asyncio.StreamWriter) -> None:
        self.writers = writers
        self.flows = asyncio.Event()
        self.flows.set()
        self.ended, self.done = asyncio.Event(), asyncio.Event()

    def cut(self) -> None:
        self.ended.set()
        self.flows.set()
        for writer in self.writers:
            writer.transport.abort()


class Cable:
    """Passes bytes on, as long as it is let."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._wires: set[_Wire] = set()
        self._pause = 0.0
        self._whole = True
        self.port = 0
        self.passed = 0
        """Bytes so far, in both directions."""
        self.held = 0
        """Pieces that are held back because their connection is frozen."""

    @asynccontextmanager
    async def laid(self, port: int = 0) -> AsyncGenerator[Cable]:
        """Listen while entered."""
        server = await asyncio.start_server(self._join, "127.0.0.1", port)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            self.cut()
            await asyncio.gather(*(wire.done.wait() for wire in self._wires))

    def cut(self) -> None:
        """Break every connection; new ones are let through."""
        for wire in list(self._wires):
            wire.cut()

    def part(self) -> None:
        """Break every connection, and each new one until `mend`."""
        self._whole = False
        self.cut()

    def freeze(self) -> None:
        """Pass nothing on of the present connections; new ones are let through."""
        for wire in self._wires:
            wire.flows.clear()

    def slow(self, rate: float) -> None:
        """Pass on `rate` bytes/s in each direction of each connection."""
        self._pause = _PIECE / rate

    def mend(self) -> None:
        """Let everything through again, also what was held back."""
        self._whole, self._pause = True, 0.0
        for wire in self._wires:
            wire.flows.set()

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            assert self._whole
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._port)
        except (OSError, AssertionError):
            writer.transport.abort()
            return
        wire = _Wire(writer, far_writer)
        self._wires.add(wire)
        try:
            await asyncio.gather(
                self._pass(wire, reader, far_writer), self._pass(wire, far_reader, writer)
            )
        finally:
            self._wires.discard(wire)
            wire.done.set()

    async def _pass(
        self, wire: _Wire, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        with suppress(OSError):
            while data := await reader.read(_PIECE):
                self.held += not wire.flows.is_set()
                await wire.flows.wait()
                if self._pause:
                    with suppress(TimeoutError):
                        async with asyncio.timeout(self._pause * len(data) / _PIECE):
                            await wire.ended.wait()
                writer.write(data)
                self.passed += len(data)
                await writer.drain()
        wire.cut()
