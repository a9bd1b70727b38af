"""Clients of the real transports, made of libraries that the gateway has no part in."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

import httpx
import websockets
from websockets.asyncio.client import ClientConnection, connect

from rcp_gateway.server import Server
from rcp_gateway.testing import Client, Message
from rcp_gateway.testing import decode as read_message
from rcp_gateway.testing import encode as write_message
from rcp_kernel.values import Encoding

MEDIA = {
    Encoding.JSON: "application/json",
    Encoding.CBOR: "application/cbor",
    Encoding.MSGPACK: "application/msgpack",
}
LISTENER: dict[str, Any] = {"port": 0}
BASE = "/rcp/v1"


def address(server: Server) -> str:
    """Return where the gateway listens."""
    return next(facts["url"] for facts in server.status.transports if "url" in facts)


def bearer(token: str | None) -> dict[str, str]:
    return {} if token is None else {"Authorization": f"Bearer {token}"}


class WebSocketClient(Client):
    """One connection of the `websockets` library."""

    def __init__(self, socket: ClientConnection, encoding: Encoding) -> None:
        super().__init__(encoding)
        self.socket = socket
        self._reader = asyncio.create_task(self._read())

    @classmethod
    async def connected(cls, server: Server, token: str | None, encoding: Encoding) -> Client:
        url = address(server).replace("http", "ws", 1) + BASE + "/ws"
        socket = await connect(
            url,
            subprotocols=[websockets.Subprotocol(f"rcp.v1.{encoding.value}")],
            additional_headers=bearer(token),
            max_size=None,
            max_queue=4,
            proxy=None,
            close_timeout=1,
        )
        assert socket.subprotocol == f"rcp.v1.{encoding.value}"
        return cls(socket, encoding)

    async def _read(self) -> None:
        with suppress(websockets.ConnectionClosed):
            while True:
                await self.reading.wait()
                data = await self.socket.recv()
                raw = data.encode() if isinstance(data, str) else data
                self.received(read_message(raw, self.encoding))

    async def transmit_raw(self, data: bytes) -> None:
        message: bytes | str = data
        if self.encoding is Encoding.JSON:
            with suppress(UnicodeDecodeError):
                message = data.decode()
        await self.socket.send(message)

    async def close(self) -> None:
        self.reading.set()
        await self.socket.close()
        await self._reader


class HttpClient(Client):
    """`POST /messages` for every envelope, side by side."""

    def __init__(self, server: Server, token: str | None, encoding: Encoding) -> None:
        super().__init__(encoding)
        self.http = httpx.AsyncClient(
            base_url=address(server),
            headers={"Content-Type": MEDIA[encoding], "Prefer": "wait=10", **bearer(token)},
            timeout=30,
            limits=httpx.Limits(max_connections=100),
            trust_env=False,
        )
        self._tasks: set[asyncio.Task[None]] = set()

    async def transmit_raw(self, data: bytes) -> None:
        task = asyncio.create_task(self._post(data))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _post(self, data: bytes) -> None:
        response = await self.http.post(BASE + "/messages", content=data)
        assert response.headers["content-type"] == MEDIA[self.encoding]
        self.received(read_message(response.content, self.encoding))

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.http.aclose()


class SseClient(HttpClient):
    """Streams for subscriptions and for the replies of commands; plain requests for the rest."""

    def __init__(self, server: Server, token: str | None, encoding: Encoding) -> None:
        super().__init__(server, token, encoding)
        self.http.headers["Prefer"] = "respond-async"
        self._streams: dict[str, asyncio.Task[None]] = {}

    async def transmit(self, message: Message) -> None:
        if message["type"] == "subscribe":
            self._begin(message["id"], self._subscribe(message))
        elif message["type"] == "execute":
            self._begin(message["id"], self._execute(message))
        elif message["type"] == "unsubscribe":
            await self._end(message["body"]["subscription"])
            self.received({"type": "unsubscribe", "id": message["id"], "status": "completed"})
        else:
            await self.transmit_raw(write_message(message, self.encoding))

    def _begin(self, id_: str, work: Any) -> None:
        self._streams[id_] = asyncio.create_task(work)

    async def _end(self, id_: str) -> None:
        task = self._streams.pop(id_)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    async def _subscribe(self, message: Message) -> None:
        body = dict(message.get("body") or {})
        paths = [message.get("path"), *body.pop("paths", ())]
        query: list[tuple[str, str]] = [("path", path) for path in paths if path is not None]
        query += [(key, _text(key, item)) for key, item in body.items()]
        query.append(("id", message["id"]))
        headers = {"Accept": "text/event-stream"}
        async with self.http.stream(
            "GET", BASE + "/events", params=query, headers=headers
        ) as response:
            if response.status_code != 200:
                self.received(json.loads(await response.aread()) | {"id": message["id"]})
                return
            first = {"type": "subscribe", "id": message["id"], "status": "completed"}
            self.received({**first, "body": {"subscription": message["id"]}})
            await self._events(response)

    async def _execute(self, message: Message) -> None:
        sent = await self.http.post(
            BASE + "/messages", content=write_message(message, self.encoding)
        )
        reply = json.loads(sent.content)
        if sent.status_code != 202:
            self.received(reply)
            return
        assert sent.headers["location"] == f"{BASE}/commands/{reply['command']}"
        headers = {"Accept": "text/event-stream"}
        url = f"{sent.headers['location']}/events"
        async with self.http.stream("GET", url, headers=headers) as response:
            await self._events(response)

    async def _events(self, response: httpx.Response) -> None:
        async for name, data in _parsed(response):
            await self.reading.wait()
            message = read_message(data, Encoding.JSON)
            assert name == {"update": "update", "notice": "notice"}.get(message["type"], "reply")
            self.received(message)

    async def close(self) -> None:
        self.reading.set()
        for id_ in list(self._streams):
            await self._end(id_)
        await super().close()


def _text(key: str, item: Any) -> str:
    if key == "fields":
        return ",".join(item)
    return item if isinstance(item, str) else json.dumps(item)


async def _parsed(response: httpx.Response) -> AsyncIterator[tuple[str, bytes]]:
    """Read a stream as its standard says: fields until an empty line, comments left out."""
    name, data = "", ""
    async for line in response.aiter_lines():
        if not line:
            if data:
                yield name, data.encode()
            name, data = "", ""
        field, _, value = line.partition(":")
        if field == "event":
            name = value.removeprefix(" ")
        elif field == "data":
            data += value.removeprefix(" ")
