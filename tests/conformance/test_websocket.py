"""The wire suite over WebSocket, through a client library that the gateway has no part in."""

from __future__ import annotations

from typing import ClassVar

from conformance.wires import LISTENER, WebSocketClient
from rcp_gateway.server import Server
from rcp_gateway.testing import Client, TransportSuite
from rcp_kernel.values import Encoding


class TestWebSocket(TransportSuite):
    transports: ClassVar = {"asgi": LISTENER, "ws": {}}

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return await WebSocketClient.connected(server, token, encoding)
