"""The endpoint: authentication, its metadata, and the hand-over to the SDK.

Foreign hosts and origins are refused earlier: the listener checks `Host` and `Origin` of every
request, which also prevents DNS rebinding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import anyio
import msgspec
from mcp.server.auth.middleware.bearer_auth import AuthenticatedUser
from mcp.server.auth.provider import AccessToken
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from mcp.server.transport_security import RequestBodyLimitMiddleware

from rcp_gateway.api import LONG_MESSAGE, Session, check_structure, to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import PayloadTooLarge, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import error_body
from rcp_mcp.caller import SESSION
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.config import McpConfig
from rcp_mcp.remedies import in_tools
from rcp_mcp.urgent import Urgent
from rcp_web.asgi import (
    Receive,
    Scope,
    Send,
    header,
    respond,
    retry_after,
    session_of,
    too_large,
)

__all__ = ["WELL_KNOWN", "Endpoint", "Metadata"]

WELL_KNOWN = "/.well-known/oauth-protected-resource"
_UNAUTHORIZED = -32001
_REFUSED = -32600
# values per request, counted like `[limits] values`: the SDK needs 1 µs for each in one step.
_VALUES = 8192


class Endpoint:
    """The ASGI application."""

    def __init__(
        self,
        config: McpConfig,
        client_api: ClientApi,
        catalogue: Catalogue,
        manager: StreamableHTTPSessionManager,
    ) -> None:
        self._config = config
        self._client_api = client_api
        self._catalogue = catalogue
        self._manager = manager
        self._urgent = Urgent(catalogue)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request on behalf of its caller."""
        try:
            session = await session_of(self._client_api, scope)
            self._check_length(session, scope)
        except Exception as error:
            internal = to_internal_error(error, path=scope["path"])
            self._client_api.refused("request", internal.code)
            await _refuse(self._config, scope, send, internal)
            return
        scope[SESSION] = session
        # RFC 9110 5.5: the SDK compares header values including their white space.
        scope["headers"] = [(name, value.strip(b" \t")) for name, value in scope["headers"]]
        if not session.principal.anonymous:
            scope["user"] = _user(session)
        await self._serve(session, scope, receive, send)

    def _check_length(self, session: Session, scope: Scope) -> None:
        """Refuse a request that is too long for its caller before reading it.

        :raises PayloadTooLarge: the announced length exceeds the limit.
        :raises RateLimited: a quota does not allow a long request now.
        """
        limit = self._client_api.longest(session.principal)
        declared = header(scope, b"content-length")
        if declared is not None and declared.isdigit():
            size = int(declared)
        else:  # the length is not known in advance
            size = limit if header(scope, b"transfer-encoding") is not None else 0
        if size > limit:
            raise too_large(limit)
        if size > self._client_api.limits.unproved:
            self._client_api.check_pace(session)

    async def _serve(self, session: Session, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the SDK serve, while the caller's credentials are valid and the listener is open."""
        begun = ended = False

        async def sent(message: Any) -> None:
            nonlocal begun, ended
            begun = begun or message["type"] == "http.response.start"
            if message["type"] == "http.response.body":
                ended = not message.get("more_body", False)
            await send(message)

        with anyio.CancelScope() as serving:
            closing: set[Callable[[], None]] = scope["extensions"]["rcp.closing"]
            closing.add(serving.cancel)
            forget = self._client_api.until_end(session, lambda _error: serving.cancel())
            try:
                limit = self._client_api.longest(session.principal)
                paced = partial(self._paced, session)
                await RequestBodyLimitMiddleware(paced, limit)(scope, receive, sent)
            finally:
                closing.discard(serving.cancel)
                forget()
        if serving.cancelled_caught and not ended:
            if not begun:
                await send({"type": "http.response.start", "status": 503, "headers": []})
            await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _paced(self, session: Session, scope: Scope, receive: Receive, send: Send) -> None:
        """Let requests take turns: the SDK needs a few ms for each, and one starts per turn."""
        turns, owner = self._client_api.turns, session.principal.identity
        first: Any = await receive()  # it has the whole body
        body: bytes = first.get("body", b"")
        stops = self._urgent.stops(session, body)
        if len(body) > LONG_MESSAGE:
            try:
                await turns.finish(owner, check_structure(body, Encoding.JSON, _VALUES))
            except PayloadTooLarge as error:
                error.remedy = "Send long values over HTTP or WebSocket, or in several calls."
                self._client_api.refused("request", error.code)
                await _refuse(self._config, scope, send, error)
                return
        await turns.place((owner, stops))
        if not stops:
            await self._catalogue.prepare(session)
        unread: list[Any] = [first]

        async def replayed() -> Any:
            return unread.pop() if unread else await receive()

        await self._manager.handle_request(scope, replayed, send)


class Metadata:
    """The protected resource metadata of the endpoint: RFC 9728."""

    def __init__(self, config: McpConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Return the metadata; no authentication is required."""
        if scope["path"] not in (WELL_KNOWN, WELL_KNOWN + self._config.path):
            await respond(send, 404, b"{}")
            return
        facts: dict[str, Any] = {
            "resource": _base(self._config, scope) + self._config.path,
            "resource_name": "RCP gateway",
            "bearer_methods_supported": ["header"],
        }
        if issuers := self._client_api.issuers:
            facts["authorization_servers"] = issuers
        headers = [(b"cache-control", b"max-age=300"), (b"access-control-allow-origin", b"*")]
        await respond(send, 200, msgspec.json.encode(facts), headers=headers)


def _user(session: Session) -> AuthenticatedUser:
    """Give the SDK the owner of the session, so that nobody else can use it."""
    principal = session.principal
    user = f"{principal.proof}:{principal.name}:{session.tenant}"
    return AuthenticatedUser(AccessToken(token="", client_id=user, scopes=[], subject=user))


async def _refuse(config: McpConfig, scope: Scope, send: Send, error: RcpError) -> None:
    details = error_body(error)
    if (remedy := in_tools(details)) is not None:
        details["remedy"] = remedy
    message = f"{error.message}. {remedy}" if remedy else error.message
    code = _UNAUTHORIZED if error.http == 401 else _REFUSED
    body = {
        "jsonrpc": "2.0",
        "id": None,
        "error": {"code": code, "message": message, "data": details},
    }
    headers = retry_after(error.retry_after)
    if error.http == 401:
        where = _base(config, scope) + WELL_KNOWN + config.path
        why = ', error="invalid_token"' if header(scope, b"authorization") else ""
        headers.append((b"www-authenticate", f'Bearer resource_metadata="{where}"{why}'.encode()))
    await respond(send, error.http, msgspec.json.encode(body), headers=headers)


def _base(config: McpConfig, scope: Scope) -> str:
    """Return the gateway's URL: as configured, or as requested by the client."""
    if config.url is not None:
        return config.url.rstrip("/")
    host = (header(scope, b"host") or b"localhost").decode("latin-1")
    return f"{scope['scheme']}://{host}{scope.get('root_path', '')}"
