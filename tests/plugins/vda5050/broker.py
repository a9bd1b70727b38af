"""A Mosquitto of a test's own, a link to it that can be cut, and a fleet manager."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import shutil
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import aiomqtt

from ports import free_port

__all__ = ["MOSQUITTO", "Cable", "Master", "broker", "cable"]

_FOLDERS = "/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin"
MOSQUITTO = shutil.which("mosquitto", path=_FOLDERS)
BOUND = 60.0  # s
OWN = ("order", "instantActions", "zoneSet", "responses")
"""Topics of the fleet manager."""


@asynccontextmanager
async def broker(folder: Path, port: int | None = None) -> AsyncGenerator[int]:
    """Run a broker while entered; yield its port."""
    assert MOSQUITTO is not None
    port = port or free_port()
    file = folder / f"mosquitto-{port}.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
    process = await asyncio.create_subprocess_exec(
        MOSQUITTO, "-c", file, stderr=asyncio.subprocess.DEVNULL
    )
    try:
        async with asyncio.timeout(BOUND):
            while True:
                try:
                    _, writer = await asyncio.open_connection("127.0.0.1", port)
                    writer.close()
                    break
                except OSError:
                    await asyncio.sleep(0.02)
        yield port
    finally:
        process.terminate()
        await process.wait()


class Cable:
    """Connections to a broker that can be cut, all at once."""

    def __init__(self, port: int) -> None:
        self._port = port
        self.port = 0
        self._writers: set[asyncio.StreamWriter] = set()
        self._news = asyncio.Condition()
        self._serving: set[asyncio.Task[None]] = set()
        self._ended = False

    def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass on one connection."""
        task = asyncio.create_task(self._serve(reader, writer))
        self._serving.add(task)
        task.add_done_callback(self._serving.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            back, forth = await asyncio.open_connection("127.0.0.1", self._port)
        except OSError:
            writer.close()
            return
        if self._ended:
            writer.close()
            forth.close()
            return
        async with self._news:
            self._writers |= {writer, forth}
            self._news.notify_all()
        with contextlib.suppress(OSError):
            await asyncio.gather(_pass(reader, forth), _pass(back, writer))
        for each in (writer, forth):
            self._writers.discard(each)
            each.close()

    async def connected(self, count: int) -> None:
        """Wait for so many connections."""
        async with asyncio.timeout(BOUND), self._news:
            await self._news.wait_for(lambda: len(self._writers) >= 2 * count)

    async def end(self) -> None:
        """Break every connection, those that are being made too, and wait until all are closed."""
        self._ended = True
        async with asyncio.timeout(BOUND):
            while True:
                for _ in range(5):  # a connection that was just accepted takes that many turns
                    await asyncio.sleep(0)
                if not self._serving:
                    return
                self.cut()
                await asyncio.wait(self._serving)

    def cut(self) -> None:
        """Break every connection."""
        writers, self._writers = self._writers, set()
        for writer in writers:
            writer.transport.abort()


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
    finally:
        writer.close()


@asynccontextmanager
async def cable(port: int) -> AsyncGenerator[Cable]:
    """Lay a cable to a broker."""
    made = Cable(port)
    server = await asyncio.start_server(made.accept, "127.0.0.1", 0)
    made.port = server.sockets[0].getsockname()[1]
    try:
        yield made
    finally:
        server.close()
        await made.end()


class Master:
    """A fleet manager with a connection of its own to the broker."""

    def __init__(self, client: aiomqtt.Client, version: str) -> None:
        self._client, self._version = client, version
        self._ids = itertools.count()
        self.heard: dict[tuple[str, str], list[dict[str, Any]]] = {}
        """Messages by serial number and topic."""
        self._news = asyncio.Condition()

    async def listen(self) -> None:
        """Hear everything, until cancelled."""
        async for message in self._client.messages:
            serial, topic = str(message.topic).split("/")[3:]
            assert isinstance(message.payload, bytes)
            if topic not in OWN:  # which may be no JSON
                async with self._news:
                    heard = self.heard.setdefault((serial, topic), [])
                    heard.append(json.loads(message.payload))
                    self._news.notify_all()

    async def send(self, serial: str, topic: str, *, kept: bool = False, **body: Any) -> None:
        """Send a message with a header; one that is `kept` is there for who subscribes later, too."""
        payload = json.dumps(self.header(serial) | body).encode()
        await self.send_raw(serial, topic, payload, kept=kept)

    async def send_raw(
        self, serial: str, topic: str, payload: bytes, *, kept: bool = False
    ) -> None:
        """Send anything."""
        base = f"uagv/v{self._version[0]}/acme/{serial}"
        await self._client.publish(f"{base}/{topic}", payload, qos=1, retain=kept)

    def header(self, serial: str) -> dict[str, Any]:
        """Return a header."""
        return {
            "headerId": next(self._ids),
            "timestamp": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "version": f"{self._version}.0",
            "manufacturer": "acme",
            "serialNumber": serial,
        }

    async def instant(self, serial: str, kind: str, id_: str = "", **parameters: Any) -> str:
        """Send an instant action; return its id."""
        id_ = id_ or f"{kind}-{next(self._ids)}"
        action: dict[str, Any] = {"actionType": kind, "actionId": id_, "blockingType": "NONE"}
        action["actionParameters"] = [{"key": k, "value": v} for k, v in parameters.items()]
        await self.send(serial, "instantActions", actions=[action])
        return id_

    def last(self, serial: str, topic: str = "state") -> dict[str, Any]:
        """Return the latest message."""
        return self.heard[serial, topic][-1]

    async def until(
        self, serial: str, holds: Callable[[dict[str, Any]], Any], topic: str = "state"
    ) -> dict[str, Any]:
        """Wait for a message that is as wanted, the latest or a later one."""
        async with asyncio.timeout(BOUND), self._news:
            while not ((heard := self.heard.get((serial, topic))) and holds(heard[-1])):
                await self._news.wait()
            return heard[-1]


@asynccontextmanager
async def master(port: int, version: str = "2.1") -> AsyncGenerator[Master]:
    """Run a fleet manager at a broker."""
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe("uagv/#", qos=1)
        made = Master(client, version)
        task = asyncio.create_task(made.listen())
        try:
            yield made
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
