"""A place that notifications are posted to."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

BOUND = 60.0  # s any wait may take


class Receiver:
    """Answers each post with the next of `answers`, then with 200; keeps what came."""

    def __init__(self) -> None:
        self.answers: list[bytes] = []
        self.heads: list[dict[str, str]] = []
        self.bodies: list[Any] = []
        self.port = 0
        self._news = asyncio.Event()

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self.port}/hook"

    async def got(self, count: int) -> None:
        """Wait until so many posts came."""
        async with asyncio.timeout(BOUND):
            while len(self.bodies) < count:
                self._news.clear()
                await self._news.wait()

    async def until(self, state: str) -> list[dict[str, Any]]:
        """Wait until a post tells a state; returns all of them."""
        async with asyncio.timeout(BOUND):
            while state not in (_state(body) for body in self.bodies):
                self._news.clear()
                await self._news.wait()
        return self.bodies

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Take posts of one connection."""
        while line := await reader.readline():
            head: dict[str, str] = {"": line.decode().strip()}
            while (field := (await reader.readline()).decode().strip()) != "":
                name, _, value = field.partition(":")
                head[name.lower()] = value.strip()
            body = await reader.readexactly(int(head["content-length"]))
            self.heads.append(head)
            self.bodies.append(json.loads(body))
            writer.write(self.answers.pop(0) if self.answers else ANSWER % b"200 OK")
            await writer.drain()
            self._news.set()
        writer.close()


ANSWER = b"HTTP/1.1 %s\r\ncontent-length: 0\r\n\r\n"


def _state(body: dict[str, Any]) -> Any:
    found = body.get("task") or body.get("statusUpdate") or {}
    return found.get("status", {}).get("state")


@asynccontextmanager
async def receiver(tls: ssl.SSLContext | None = None) -> AsyncGenerator[Receiver]:
    """Listen while entered."""
    made = Receiver()
    server = await asyncio.start_server(made.serve, "127.0.0.1", 0, ssl=tls)
    made.port = server.sockets[0].getsockname()[1]
    try:
        yield made
    finally:
        server.close()
