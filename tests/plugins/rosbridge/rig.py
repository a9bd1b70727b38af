"""A gateway with rosbridge on real ports, and a client that speaks it by hand."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import cbor2
import msgspec
from websockets.asyncio.client import ClientConnection, connect

from configuration import backend, key, listener, table
from rcp_gateway.testing import Served, serve
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import parse
from rcp_kernel.spi import BackendKind
from rcp_rosbridge import ROSBRIDGE

BOUND = 60.0  # s that any wait of a test may take
OPERATOR = "operator-of-these-tests"
ROVER = backend("rover", use="sim", seed=1)
ROBOT = backend("robot")
OPEN = table("anonymous", role="operator")
Message = dict[str, Any]


class Site:
    """A gateway that runs."""

    def __init__(self, served: Served) -> None:
        self.served = served
        facts = next(f for f in served.server.status.transports if "url" in f)
        self.url = facts["url"].replace("http", "ws", 1)
        self.port = facts.get("ports", {}).get("rosbridge")

    @property
    def kernel(self) -> Any:
        return self.served.server.gateway


@asynccontextmanager
async def site(
    *tables: str,
    kinds: tuple[BackendKind, ...] = (),
    limits: str = "",
    clock: Clock = SYSTEM_CLOCK,
    **options: Any,
) -> AsyncGenerator[Site]:
    """Serve; `options` are those of the plugin."""
    given = {"port": 0, "status": "info", **options}
    text = "".join(tables) + listener() + limits
    text += table("transports", http=False, ws=False, sse=False)
    config = parse(text + key("operator", OPERATOR), "test")
    config = msgspec.structs.replace(config, plugins={"rosbridge": given})
    async with serve(config, *kinds, adapters=(ROSBRIDGE,), clock=clock) as served:
        yield Site(served)


class Page:
    """A client that sends what a test says, and keeps what it receives."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self._received: list[Message] = []
        self._numbers = iter(range(1, 10_000))

    async def send(self, **operation: Any) -> None:
        """Send an operation."""
        await self.socket.send(json.dumps(operation))

    async def until(self, wanted: Callable[[Message], bool], bound: float = BOUND) -> Message:
        """Return the next message that is wanted; others are kept for later."""
        for place, message in enumerate(self._received):
            if wanted(message):
                return self._received.pop(place)
        async with asyncio.timeout(bound):
            while True:
                message = decoded(await self.socket.recv())
                if wanted(message):
                    return message
                self._received.append(message)

    async def op(self, name: str, **fields: Any) -> Message:
        """Return the next message of an operation, with these fields."""
        return await self.until(
            lambda m: m["op"] == name and all(m.get(k) == v for k, v in fields.items())
        )

    async def status(self, text: str) -> Message:
        """Return the next status message that has a text in it."""
        return await self.until(lambda m: m["op"] == "status" and text in m["msg"])

    async def message(self, topic: str) -> Any:
        """Return the next message of a topic."""
        return (await self.op("publish", topic=topic))["msg"]

    async def call(self, service: str, args: Any = None, **more: Any) -> Message:
        """Call a service and return its response."""
        id_ = f"call-{next(self._numbers)}"
        body = {} if args is None else {"args": args}
        await self.send(op="call_service", id=id_, service=service, **body, **more)
        return await self.op("service_response", id=id_)

    async def values(self, service: str, **args: Any) -> Any:
        """Call a service that succeeds; return its values."""
        response = await self.call(service, args)
        assert response["result"] is True, response
        return response["values"]


def decoded(data: str | bytes) -> Message:
    """Decode a message, in JSON or CBOR."""
    if isinstance(data, str):
        return json.loads(data)
    return cbor2.loads(data)


@asynccontextmanager
async def page(
    site: Site, token: str | None = None, path: str = "/rosbridge", **options: Any
) -> AsyncGenerator[Page]:
    """Connect a client."""
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    options.setdefault("max_size", None)
    async with connect(
        site.url + path, additional_headers=headers, proxy=None, **options
    ) as socket:
        yield Page(socket)
