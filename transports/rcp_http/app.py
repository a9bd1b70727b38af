"""The ASGI application: from a URL to its handler. Reads of resources come first and go straight."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import structlog

from rcp_http.answers import Answers
from rcp_http.calls import Calls
from rcp_http.config import HttpConfig
from rcp_http.context import Context
from rcp_http.octets import range_headers
from rcp_http.request import HttpRequest
from rcp_kernel.asgi import MEDIA, Headers, Receive, Scope, Send, respond, retry_after
from rcp_kernel.client_api import ClientApi
from rcp_kernel.contract.pending import to_internal_error
from rcp_kernel.errors import InvalidPath, RcpError, UnknownPath, UnsupportedOperation
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure

__all__ = ["PREFIX", "HttpApp"]

log = structlog.get_logger("rcp.http")
PREFIX = "/rcp/v1"
_CONTEXT = PREFIX + "/context/"
_TYPES = {"GET": "read", "PUT": "write", "POST": "execute"}
Handler = Callable[[HttpRequest, Session, Receive, Send], Awaitable[None]]


class HttpApp:
    """Serves `/rcp/v1`."""

    def __init__(self, config: HttpConfig, client_api: ClientApi) -> None:
        self._client_api = client_api
        self._answers = Answers(config, client_api.outbound, client_api.turns)
        self._context = Context(client_api, config, self._answers)
        self._calls = Calls(client_api, config, self._answers, self._context)
        calls = self._calls
        self._fixed: dict[str, dict[str, Handler]] = {
            "/messages": {"POST": calls.messages},
            "/commands": {"GET": lambda a, s, _, send: calls.commands(a, s, send)},
            "/discovery": {"GET": lambda a, s, _, send: calls.discovery(a, s, send)},
            "/status": {"GET": lambda a, s, _, send: calls.status(a, s, send)},
            "/schemas": {"GET": lambda a, s, _, send: calls.schemas(a, s, send)},
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request; whatever goes wrong is an envelope."""
        path: str = scope["path"]
        asked: HttpRequest | None = None
        try:
            asked = HttpRequest(scope)
            asked.negotiate()
            if asked.method == "GET" and path.startswith(_CONTEXT):
                session = asked.session(self._client_api) or await asked.waited(self._client_api)
                await self._context.read(asked, session, path[len(_CONTEXT) - 1 :], send)
            else:
                await self._route(asked, path, receive, send)
        except Exception as error:
            told = to_internal_error(error, path=path)
            await self._refuse(asked, scope, path, told, send)

    async def _route(self, asked: HttpRequest, path: str, receive: Receive, send: Send) -> None:
        rest = path[len(PREFIX) :]
        if path.startswith(_CONTEXT):
            await self._on_context(asked, path[len(_CONTEXT) - 1 :], receive, send)
            return
        handlers = self._fixed.get(rest) or self._named(rest)
        if handlers is None:
            raise UnknownPath(f"nothing found at {path}", remedy="See /rcp/v1/openapi.json.")
        if asked.method == "OPTIONS":
            await respond(
                send, 204, b"", headers=[(b"allow", ", ".join(_methods(handlers)).encode())]
            )
            return
        handler = handlers.get(asked.method)
        if handler is None:
            raise _not_taken(asked, path, _methods(handlers))
        session = asked.session(self._client_api) or await asked.waited(self._client_api)
        await handler(asked, session, receive, send)

    async def _on_context(
        self, asked: HttpRequest, path: str, receive: Receive, send: Send
    ) -> None:
        session = asked.session(self._client_api) or await asked.waited(self._client_api)
        if asked.method == "OPTIONS":
            await self._context.options(asked, session, path, send)
        elif asked.method == "PUT":
            await self._context.write(asked, session, path, receive, send)
        elif asked.method == "POST":
            await self._context.execute(asked, session, path, receive, send)
        else:
            raise _not_taken(asked, path, await self._taken(session, path))

    async def _taken(self, session: Session, path: str) -> list[str]:
        """Return what a resource takes, or what any does if there is none: 405 in either case."""
        try:
            return await self._context.methods(session, path)
        except (InvalidPath, UnknownPath):
            return ["GET", "HEAD", "PUT", "POST", "OPTIONS"]

    def _named(self, rest: str) -> dict[str, Handler] | None:
        branch, _, name = rest.removeprefix("/").partition("/")
        calls = self._calls
        if not name or "/" in name:
            return None
        if branch == "commands":
            return {
                "GET": lambda a, s, _, send: calls.command(a, s, name, send),
                "DELETE": lambda a, s, _, send: calls.cancel(a, s, name, send),
            }
        if branch == "schemas":
            return {"GET": lambda a, s, _, send: calls.schema(a, s, name, send)}
        return None

    async def _refuse(
        self, asked: HttpRequest | None, scope: Scope, path: str, error: RcpError, send: Send
    ) -> None:
        encoding = Encoding.JSON if asked is None else asked.encoding
        type_ = "error"
        if path.startswith(_CONTEXT):
            type_ = _TYPES.get("GET" if asked is None else asked.method, "error")
        self._client_api.refused(type_, error.code)
        id_ = None if asked is None else _id(asked)
        headers: Headers = range_headers(error) + retry_after(error.retry_after)
        if error.http == 401:
            headers.append((b"www-authenticate", b"Bearer"))
        if error.http == 405 and error.details is not None:
            headers.append((b"allow", ", ".join(error.details["allowed"]).encode()))
        if error.http in (408, 413):
            headers.append((b"connection", b"close"))  # the rest of the body is not read
        body = encode_reply(failure(error, type_, id_), encoding)
        await respond(send, error.http, body, MEDIA[encoding], headers)


def _id(asked: HttpRequest) -> str | None:
    named = asked.envelope.get("id")
    if named is not None and len(named) <= 128:
        return named.decode("latin-1")
    values = asked.query.get("id", ())
    return values[0] if values and 0 < len(values[0]) <= 128 else None


def _methods(handlers: dict[str, Handler]) -> list[str]:
    return [*handlers, *(["HEAD"] if "GET" in handlers else []), "OPTIONS"]


def _not_taken(asked: HttpRequest, path: str, methods: list[str]) -> UnsupportedOperation:
    return UnsupportedOperation(
        f"{path} does not support {asked.method}",
        remedy=f"Use {' or '.join(methods)}.",
        details={"allowed": methods},
    )
