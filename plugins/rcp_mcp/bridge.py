"""Bridge between stdio and a gateway's endpoint; messages pass unchanged.

Both sides use the SDK's transports. The bridge adds the headers that HTTP requires, and replies
when the gateway cannot be reached.
"""

from __future__ import annotations

import json
import re
import ssl
from typing import Any

import anyio
import httpx2
from mcp.client.streamable_http import streamable_http_client
from mcp.server.stdio import stdio_server
from mcp.shared.inbound import encode_header_value
from mcp.shared.message import ClientMessageMetadata, SessionMessage
from mcp.types import JSONRPCRequest, JSONRPCResponse

__all__ = ["bridge"]

_VERSION = "io.modelcontextprotocol/protocolVersion"
_SESSION = "mcp-session-id"
_INITIALIZED = b'{"jsonrpc":"2.0","method":"notifications/initialized"}'
_PATIENCE = httpx2.Timeout(30.0, read=3600.0)  # s; the gateway sends something every 15


async def bridge(url: str, headers: dict[str, str], cacert: str | None = None) -> None:
    """Forward messages in both directions until stdin closes."""
    trust = ssl.create_default_context()
    if cacert is not None:
        trust.load_verify_locations(cacert)
    async with (
        httpx2.AsyncClient(
            headers=headers, timeout=_PATIENCE, transport=_Reached(url, trust)
        ) as http,
        stdio_server() as (incoming, outgoing),
        outgoing,  # closed before stdio, whose writer waits for it
        streamable_http_client(url, http_client=http) as (responses, send),
        anyio.create_task_group() as both,
    ):
        versions = _Versions()

        async def back() -> None:
            async for message in responses:
                if isinstance(message, SessionMessage):
                    versions.note(message)
                    await outgoing.send(message)

        both.start_soon(back)
        async for message in incoming:
            if isinstance(message, SessionMessage):
                message.metadata = ClientMessageMetadata(headers=versions.headers(message))
                await send.send(message)
        both.cancel_scope.cancel()


class _Versions:
    """What HTTP needs to know of each message in addition to its body."""

    def __init__(self) -> None:
        self._initialize: Any = None
        self._agreed: str | None = None
        """Protocol version of a client that started with `initialize`."""

    def headers(self, message: SessionMessage) -> dict[str, str]:
        """Return the headers for a message from the client."""
        plain = message.message
        params: dict[str, Any] = getattr(plain, "params", None) or {}
        if isinstance(plain, JSONRPCRequest) and plain.method == "initialize":
            self._initialize, self._agreed = plain.id, None
            return {}
        meta = params.get("_meta")
        version = meta.get(_VERSION) if isinstance(meta, dict) else None  # pyright: ignore[reportUnknownMemberType]
        if not isinstance(version, str):
            return {} if self._agreed is None else {"mcp-protocol-version": self._agreed}
        found = {"mcp-protocol-version": version, "mcp-method": getattr(plain, "method", "")}
        for key in ("name", "uri", "taskId"):
            if isinstance(named := params.get(key), str):
                found["mcp-name"] = encode_header_value(named)
                break
        return found

    def note(self, message: SessionMessage) -> None:
        """Record the version from the response to `initialize`."""
        plain = message.message
        if isinstance(plain, JSONRPCResponse) and plain.id == self._initialize:
            agreed = plain.result.get("protocolVersion")
            self._agreed = agreed if isinstance(agreed, str) else None


class _Reached(httpx2.AsyncHTTPTransport):
    """An HTTP transport that recovers from failures.

    It reports why the gateway cannot be reached, so that the assistant can retry, and reopens an
    older client's session that a restart of the gateway has ended.
    """

    def __init__(self, url: str, trust: ssl.SSLContext) -> None:
        super().__init__(verify=trust)
        self._url = url
        self._opening: httpx2.Request | None = None
        self._session: str | None = None
        """The session that replaces the one known to the client."""
        self._reopening = anyio.Lock()

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        """Send a request."""
        if request.method == "POST" and json.loads(request.content).get("method") == "initialize":
            request.headers.pop(_SESSION, None)
            self._opening, self._session = request, None
        used = request.headers.get(_SESSION)
        if used is not None and self._session is not None:
            used = request.headers[_SESSION] = self._session
        response = await self._send(request)
        if response.status_code == 404 and used is not None and await self._reopened(used):
            await response.aclose()
            request.headers[_SESSION] = self._session or used
            response = await self._send(request)
        return response

    async def _send(self, request: httpx2.Request) -> httpx2.Response:
        try:
            return await super().handle_async_request(request)
        except httpx2.TransportError as error:
            message = (
                f"the gateway at {self._url} cannot be reached: {error or type(error).__name__}"
            )
            reply = {"jsonrpc": "2.0", "id": None, "error": {"code": -32000, "message": message}}
            headers = {"content-type": "application/json"}
            return httpx2.Response(
                503, headers=headers, content=json.dumps(reply).encode(), request=request
            )

    async def _reopened(self, lost: str) -> bool:
        """Open a session as the client did; return whether a new one is available."""
        async with self._reopening:
            opening = self._opening
            if opening is None or self._session not in (None, lost):
                return self._session is not None
            answer = await self._send(opening)
            body = await answer.aread()
            await answer.aclose()
            self._session = answer.headers.get(_SESSION)
            if self._session is None:
                return False
            found = re.search(rb'"protocolVersion":"([0-9-]+)"', body)
            agreed = found[1].decode() if found else ""
            headers = {**opening.headers, _SESSION: self._session, "mcp-protocol-version": agreed}
            headers.pop("content-length", None)
            ready = httpx2.Request("POST", opening.url, headers=headers, content=_INITIALIZED)
            await (await self._send(ready)).aclose()
            return True
