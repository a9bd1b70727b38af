"""The ASGI application: resources and envelopes directly, the rest by Litestar (decision 0031)."""

from __future__ import annotations

from litestar import Router
from litestar.di import Provide

from rcp_gateway.api import Session, to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_http.answers import MESSAGES, Answers
from rcp_http.call import Call
from rcp_http.config import HttpConfig
from rcp_http.context import Context
from rcp_http.controllers import Catalogue, Commands, Files, Status
from rcp_http.logins import Login
from rcp_http.messages import Messages
from rcp_http.oidc import OidcLogin
from rcp_http.request import HttpRequest
from rcp_kernel.errors import InvalidPath, RcpError, UnknownPath
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure
from rcp_web.application import Application, WebRequest, scope_of
from rcp_web.asgi import MEDIA, Receive, Scope, Send, respond
from rcp_web.calls import parameters_of
from rcp_web.ranges import range_headers
from rcp_web.refusals import NotTaken, Refusal, headers_of

__all__ = ["PREFIX", "HttpApp"]

PREFIX = "/rcp/v1"
_CONTEXT = PREFIX + "/context/"
_TYPES = {"GET": "read", "PUT": "write", "POST": "execute"}
_REQUEST = "rcp.request"
"""Key of the request's head in the scope, for the controllers."""


class HttpApp:
    """Serves `/rcp/v1`."""

    def __init__(self, config: HttpConfig, client_api: ClientApi) -> None:
        self._client_api = client_api
        self._answers = Answers(config, client_api.outbound, client_api.turns)
        self._context = Context(client_api, config, self._answers)
        self._messages = Messages(client_api, config, self._answers, self._context)
        self.calls = Application(
            [Router(PREFIX, route_handlers=[Catalogue, Status, Commands, Files, Login, OidcLogin])],
            dependencies={
                "call": Provide(self._call),
                "client_api": Provide(self._get_client_api, sync_to_thread=False),
            },
            refuse=self._refusal,
            remedy="See /rcp/v1/openapi.json.",
            described=True,
        )
        """Everything except resources and envelopes."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request; errors are envelopes."""
        path: str = scope["path"]
        try:
            scope[_REQUEST] = http = HttpRequest(scope)
            http.negotiate()
            if path.startswith(_CONTEXT):
                session = http.session(self._client_api) or await http.waited(self._client_api)
                rest = path[len(_CONTEXT) - 1 :]
                if http.method == "GET":
                    await self._context.read(http, session, rest, receive, send)
                else:
                    await self._on_context(http, session, rest, receive, send)
            elif path == MESSAGES:
                await self._on_messages(http, receive, send)
            else:
                await self.calls(scope, receive, send)
        except Exception as error:
            told = to_internal_error(error, path=path)
            body, media, headers = self._refusal(scope, told)
            await respond(send, told.http, body, media, [*headers, *headers_of(told)])

    def _get_client_api(self) -> ClientApi:
        return self._client_api

    async def _call(self, request: WebRequest) -> Call:
        http: HttpRequest = scope_of(request)[_REQUEST]
        session = http.session(self._client_api) or await http.waited(self._client_api)
        http.allow(*parameters_of(request))
        return Call(self._client_api, self._answers, http, session)

    async def _on_messages(self, http: HttpRequest, receive: Receive, send: Send) -> None:
        if http.method == "OPTIONS":
            await respond(send, 204, b"", headers=[(b"allow", b"POST, OPTIONS")])
            return
        if http.method != "POST":
            raise NotTaken(http.path, http.method, ["POST", "OPTIONS"])
        session = http.session(self._client_api) or await http.waited(self._client_api)
        await self._messages.post(http, session, receive, send)

    async def _on_context(
        self, http: HttpRequest, session: Session, path: str, receive: Receive, send: Send
    ) -> None:
        if http.method == "OPTIONS":
            await self._context.options(http, session, path, send)
        elif http.method == "PUT":
            await self._context.write(http, session, path, receive, send)
        elif http.method == "POST":
            await self._context.execute(http, session, path, receive, send)
        else:
            raise NotTaken(path, http.method, await self._taken(session, path))

    async def _taken(self, session: Session, path: str) -> list[str]:
        """Return the methods of a resource, or of any if it does not exist: 405 in both cases."""
        try:
            return await self._context.methods(session, path)
        except (InvalidPath, UnknownPath):
            return ["GET", "HEAD", "PUT", "POST", "OPTIONS"]

    def _refusal(self, scope: Scope, error: RcpError) -> Refusal:
        http: HttpRequest | None = scope.get(_REQUEST)
        encoding = Encoding.JSON if http is None else http.encoding
        type_ = "error"
        if scope["path"].startswith(_CONTEXT):
            type_ = _TYPES.get("GET" if http is None else http.method, "error")
        self._client_api.refused(type_, error.code)
        headers = range_headers(error)
        if error.http in (408, 413):
            headers.append((b"connection", b"close"))  # the rest of the body is not read
        body = encode_reply(failure(error, type_, None if http is None else _id(http)), encoding)
        return Refusal(body, MEDIA[encoding], tuple(headers))


def _id(http: HttpRequest) -> str | None:
    named = http.envelope.get("id")
    if named is not None and len(named) <= 128:
        return named.decode("latin-1")
    values = http.query.get("id", ())
    return values[0] if values and 0 < len(values[0]) <= 128 else None
