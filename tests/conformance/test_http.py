"""The wire suite over HTTP: every envelope a request of its own."""

from __future__ import annotations

from typing import ClassVar

from conformance.wires import LISTENER, HttpClient
from rcp_gateway.server import Server
from rcp_gateway.testing import Client, TransportSuite
from rcp_kernel.values import Encoding


class TestHttp(TransportSuite):
    offers = frozenset({"request-only"})
    transports: ClassVar = {"asgi": LISTENER, "http": {}}

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return HttpClient(server, token, encoding)
