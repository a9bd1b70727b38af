"""Receivers of notifications: an HTTP server, as slow or broken as a test wants it."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from typing import Any, NamedTuple

from standardwebhooks import Webhook

KEY = "MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSwMfKQ9r8GKYqrTwjU"
BOUND = 60.0  # s


class Got(NamedTuple):
    """A request."""

    path: str
    headers: dict[str, str]
    body: Any


class Receiver:
    """Answers each POST with `status`, once `gate` lets it; 401 if the signature or time is wrong."""

    def __init__(self, *, signed: bool = True, now: Callable[[], float] = time.time) -> None:
        self.got: list[Got] = []
        self.status = 200
        self.extra = ""
        self.gate = asyncio.Event()
        self.gate.set()
        self.asked = 0
        self.ids: list[str] = []
        """Of every request, also those that were not taken."""
        self.port = 0
        self._signed = signed
        self._now = now
        self._changed = asyncio.Condition()
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook"

    async def up(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def down(self) -> None:
        """Refuse connections from now on."""
        assert self._server is not None
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            while await self._answer(reader, writer):
                pass
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass
        finally:
            self._tasks.discard(task)
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        first, *lines = head.strip().split("\r\n")
        headers = {n.lower(): v for n, _, v in (line.partition(": ") for line in lines)}
        body = await reader.readexactly(int(headers["content-length"]))
        self.asked += 1
        self.ids.append(headers.get("webhook-id", ""))
        async with self._changed:
            self._changed.notify_all()
        await self.gate.wait()
        status = self.status if self._proved(headers, body) else 401
        writer.write(f"HTTP/1.1 {status} X\r\n{self.extra}content-length: 0\r\n\r\n".encode())
        await writer.drain()
        if status < 300:
            self.got.append(Got(first.split()[1], headers, json.loads(body)))
        async with self._changed:
            self._changed.notify_all()
        return True

    def _proved(self, headers: dict[str, str], body: bytes) -> bool:
        """Check the signature as Standard Webhooks specify, by the library of others."""
        if not self._signed:
            return True
        moment = int(headers["webhook-timestamp"])
        if abs(moment - self._now()) > 300:
            return False
        at = datetime.fromtimestamp(moment, UTC)
        expected = Webhook(KEY).sign(headers["webhook-id"], at, body.decode())
        return headers["webhook-signature"] == expected

    async def until(self, what: Callable[[], bool]) -> None:
        async with asyncio.timeout(BOUND), self._changed:
            await self._changed.wait_for(what)

    async def count(self, number: int) -> list[Got]:
        """Wait for so many messages that were taken."""
        await self.until(lambda: len(self.got) >= number)
        return self.got


@asynccontextmanager
async def receiver(
    *, signed: bool = True, now: Callable[[], float] = time.time
) -> AsyncGenerator[Receiver]:
    one = Receiver(signed=signed, now=now)
    await one.up()
    try:
        yield one
    finally:
        await one.down()
