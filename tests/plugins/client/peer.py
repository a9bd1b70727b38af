"""A gateway that a test plays by hand, frame by frame."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.typing import Subprotocol

Message = dict[str, Any]


class Peer:
    """Answers `hello` by itself; everything else waits in `inbox` for the test."""

    def __init__(self) -> None:
        self.port = 0
        self.inbox: asyncio.Queue[Message] = asyncio.Queue()
        self.greet: Callable[[Message], Message | None] = self.welcome
        self.segment_size = 2048
        self._socket: ServerConnection | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def welcome(self, hello: Message) -> Message | None:
        body = {
            "session": "s-1",
            "resume_token": "secret",
            "limits": {"segment_size": self.segment_size},
        }
        return {**reply(hello, body), "timestamp": "2026-05-29T14:12:04.000000000Z"}

    async def send(self, message: Message | str) -> None:
        assert self._socket is not None
        await self._socket.send(message if isinstance(message, str) else json.dumps(message))

    async def hang_up(self) -> None:
        assert self._socket is not None
        self._socket.transport.abort()

    async def next(self, type_: str) -> Message:
        """Take the next message, which must be of a type."""
        message = await self.inbox.get()
        assert message["type"] == type_, message
        return message

    async def handle(self, socket: ServerConnection) -> None:
        self._socket = socket
        async for data in socket:
            message = json.loads(data)
            if message["type"] == "hello":
                if (answer := self.greet(message)) is not None:
                    await self.send(answer)
            else:
                self.inbox.put_nowait(message)


@asynccontextmanager
async def peer() -> AsyncGenerator[Peer]:
    """Play a gateway that speaks JSON while entered."""
    made = Peer()
    spoken = [Subprotocol("rcp.v1.json")]
    async with serve(made.handle, "127.0.0.1", 0, subprotocols=spoken) as server:
        made.port = next(iter(server.sockets)).getsockname()[1]
        yield made


def reply(request: Message, body: Any = None, **facts: Any) -> Message:
    """Make the final reply to a request."""
    done = {"type": request["type"], "id": request["id"], "status": "completed", "body": body}
    return {**done, **facts}


def refusal(request: Message, code: str, **facts: Any) -> Message:
    """Make the reply that refuses a request."""
    error = {"code": code, "message": f"no: {code}", **facts}
    return {"type": request["type"], "id": request["id"], "status": "rejected", "error": error}


def segments(whole: Message, name: str = "t-1", size: int = 64) -> list[Message]:
    """Cut a message as a gateway does."""
    data = json.dumps(whole).encode()
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    facts = {"total": len(parts), "size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    return [
        {
            "type": "segment",
            "id": name,
            "num": num,
            **facts,
            "body": base64.b64encode(part).decode(),
        }
        for num, part in enumerate(parts)
    ]


def update(subscribe: Message, seq: int, **facts: Any) -> Message:
    """Make one update of a subscription."""
    stamp = "2026-05-29T14:12:04.000000000Z"
    path = subscribe["path"]
    named = {"type": "update", "id": subscribe["id"], "path": path, "seq": seq, "timestamp": stamp}
    return {**named, "body": seq, **facts}
