"""A Foxglove client in a few lines, which knows nothing of the gateway's code."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

BOUND = 60.0  # s that any wait of a test may take
Json = dict[str, Any]


class Viewer:
    """What a viewer has received so far."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.texts: list[Json] = []
        self.frames: list[bytes] = []
        self.channels: dict[str, Json] = {}
        self.services: dict[str, Json] = {}
        self.statuses: dict[str, Json] = {}
        self.closed: ConnectionClosed | None = None
        self._news = asyncio.Event()
        self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        try:
            async for message in self.socket:
                if isinstance(message, bytes):
                    self.frames.append(message)
                else:
                    self._take(json.loads(message))
                self._news.set()
        except ConnectionClosed as error:
            self.closed = error
        self._news.set()

    def _take(self, message: Json) -> None:
        self.texts.append(message)
        match message["op"]:
            case "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"]}
            case "unadvertise":
                gone = message["channelIds"]
                self.channels = {t: c for t, c in self.channels.items() if c["id"] not in gone}
            case "advertiseServices":
                self.services |= {one["name"]: one for one in message["services"]}
            case "unadvertiseServices":
                gone = message["serviceIds"]
                self.services = {n: s for n, s in self.services.items() if s["id"] not in gone}
            case "status" if "id" in message:
                self.statuses[message["id"]] = message
            case "removeStatus":
                for id_ in message["statusIds"]:
                    self.statuses.pop(id_, None)
            case _:
                pass

    async def until(self, what: Callable[[], Any]) -> Any:
        """Wait until something is true of what was received; return it."""
        async with asyncio.timeout(BOUND):
            while not (found := what()):
                self._news.clear()
                await self._news.wait()
        return found

    async def op(self, op: str, **fields: Any) -> Json:
        """Wait for the first message of an operation with some fields, and take it out."""

        def found() -> Json | None:
            for message in self.texts:
                if message["op"] == op and all(message.get(k) == v for k, v in fields.items()):
                    return message
            return None

        message = await self.until(found)
        self.texts.remove(message)
        return message

    async def frame(self, opcode: int) -> bytes:
        """Wait for the first binary message with an opcode, and take it out."""
        found = await self.until(lambda: [f for f in self.frames if f[0] == opcode])
        self.frames.remove(found[0])
        return found[0]

    async def send(self, op: str, **fields: Any) -> None:
        await self.socket.send(json.dumps({"op": op, **fields}))

    async def channel(self, topic: str) -> Json:
        return await self.until(lambda: self.channels.get(topic))

    async def subscribe(self, topic: str, number: int = 1) -> Json:
        channel = await self.channel(topic)
        await self.send("subscribe", subscriptions=[{"id": number, "channelId": channel["id"]}])
        return channel

    async def message(self, number: int = 1) -> tuple[int, bytes]:
        """Return the time and the payload of the next message of a subscription."""

        def found() -> bytes | None:
            for frame in self.frames:
                if frame[0] == 1 and struct.unpack_from("<I", frame, 1)[0] == number:
                    return frame
            return None

        frame = await self.until(found)
        self.frames.remove(frame)
        return struct.unpack_from("<Q", frame, 5)[0], frame[13:]

    async def publish(self, channel: int, value: Any) -> None:
        payload = value if isinstance(value, bytes) else json.dumps(value).encode()
        await self.socket.send(struct.pack("<BI", 1, channel) + payload)

    async def call(self, name: str, value: Any, id_: int = 7, encoding: str = "json") -> None:
        service = await self.until(lambda: self.services.get(name))
        payload = value if isinstance(value, bytes) else json.dumps(value).encode()
        head = struct.pack("<BIII", 2, service["id"], id_, len(encoding))
        await self.socket.send(head + encoding.encode() + payload)

    async def response(self) -> tuple[int, str, bytes]:
        """Return the call id, the encoding and the payload of the next response."""
        frame = await self.frame(3)
        _, _, id_, length = struct.unpack_from("<BIII", frame)
        return id_, frame[13 : 13 + length].decode(), frame[13 + length :]

    async def close(self) -> None:
        await self.socket.close()
        await self._reading


@asynccontextmanager
async def viewing(
    url: str, token: str | None = None, subprotocol: str = "foxglove.sdk.v1", **options: Any
) -> AsyncGenerator[Viewer]:
    """Connect a viewer to a WebSocket."""
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    async with connect(
        url.replace("http", "ws", 1),
        subprotocols=[Subprotocol(subprotocol)],
        additional_headers=headers,
        proxy=None,
        max_size=None,
        **options,
    ) as socket:
        viewer = Viewer(socket)
        try:
            yield viewer
        finally:
            await viewer.close()
