"""The wire suite in memory: the gateway itself, with no transport to blame."""

from __future__ import annotations

from rcp_gateway.server import Server
from rcp_gateway.testing import Client, MemoryClient, TransportSuite
from rcp_kernel.values import Encoding


class TestMemory(TransportSuite):
    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return MemoryClient(server.client_api, token, encoding)
