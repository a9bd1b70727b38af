"""The wire suite over server-sent events, with plain HTTP for the requests."""

from __future__ import annotations

from typing import ClassVar

from conformance.wires import LISTENER, SseClient
from rcp_gateway.server import Server
from rcp_gateway.testing import Client, TransportSuite
from rcp_kernel.values import Encoding


class TestSse(TransportSuite):
    offers = frozenset({"stream"})
    encodings = (Encoding.JSON,)
    transports: ClassVar = {"asgi": LISTENER, "http": {}, "sse": {}}

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return SseClient(server, token, encoding)
