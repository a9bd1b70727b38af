"""The ASGI application: authentication, tenant, and the dispatch to the SDK's endpoints."""

from __future__ import annotations

import asyncio
from typing import Any, NamedTuple, cast
from urllib.parse import parse_qs

import msgspec
import structlog
from a2a.server.request_handlers import RequestHandler
from a2a.server.routes import create_jsonrpc_routes, create_rest_routes
from a2a.types.a2a_pb2 import TaskState
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount

from rcp_a2a.callers import CALLER, Caller, Callers
from rcp_a2a.cards import Cards
from rcp_a2a.config import A2aConfig
from rcp_a2a.messages import VALUES, count_values
from rcp_a2a.places import CARD, JWKS, Place, place_of
from rcp_a2a.refusals import NOT_FOUND, NOT_TAKEN, Trouble, refuse, trouble_of
from rcp_a2a.stops import SHORT, as_request
from rcp_gateway.api import Session, to_internal_error
from rcp_gateway.client_api import Asgi, ClientApi
from rcp_kernel.errors import BadRequest, Forbidden, PayloadTooLarge, RateLimited, RcpError
from rcp_web.asgi import (
    Receive,
    Scope,
    Send,
    bearer,
    header,
    peer_of,
    read_body,
    session_of,
    until_gone,
)

__all__ = ["App"]

log = structlog.get_logger("rcp.a2a")
_BODY_TIMEOUT = 30.0  # s
_STEP = 250  # values that take a whole turn
_STATES = frozenset(TaskState.keys())
_TAKEN = (b"application/json", b"application/a2a+json")


class _Params(msgspec.Struct):
    tenant: str = ""
    status: str | int | None = None


class _Call(msgspec.Struct):
    id: str | int | None = None
    method: str = ""
    params: _Params = msgspec.field(default_factory=_Params)


class _Asked(NamedTuple):
    """What was read of a request before the SDK parses it."""

    call: _Call = _Call()
    plain: Any = None
    values: int = 0
    """Number of values in the body."""


class App:
    """Serves the cards and both bindings."""

    def __init__(
        self, config: A2aConfig, client_api: ClientApi, cards: Cards, handler: RequestHandler
    ) -> None:
        old = config.compatible
        self._limit = min(config.message, client_api.limits.message)
        self._client_api = client_api
        self._cards = cards
        callers = Callers()
        routes = [
            *create_jsonrpc_routes(handler, "/", callers, enable_v0_3_compat=old),
            # Routes for tenants are removed: the tenant is determined earlier.
            *(
                route
                for route in create_rest_routes(handler, callers, enable_v0_3_compat=old)
                if not isinstance(route, Mount)
            ),
        ]
        app = Starlette(routes=routes, exception_handlers={HTTPException: _not_here})
        app.router.redirect_slashes = False
        self._sdk: Asgi = cast("Asgi", app)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request; errors use the format of the binding."""
        place = place_of(scope["path"])
        call = _Asked()
        try:
            if place.rest in (CARD, JWKS):
                await self._cards.serve(scope, send, place)
                return
            body = b""
            if scope["method"] == "POST":
                _check_type(scope)
                longest, refusal = await self._look(scope)
                body = await read_body(receive, min(self._limit, longest), _BODY_TIMEOUT)
                call = _read(scope, place, body)
                if refusal is not None:
                    raise refusal
            _check_state(scope, place, call.call)
            session = await session_of(self._client_api, scope, _tenant(place, call.call))
            stops = self._is_stop(session, place, call, len(body))
            self._charge(session, stops=stops)
            caller = Caller(session, self._cards.base(scope), stops=stops)
            # The SDK needs a few ms per request, more for a long one: they take turns.
            for _ in range(1 + call.values // _STEP):
                await self._client_api.turns.place((session.principal.identity, stops))
            inner = {
                **scope,
                "path": place.rest,
                "root_path": "",
                CALLER: caller,
            }
            await _Exchange(self._client_api, inner, receive, send, body).run(self._sdk)
        except Exception as error:
            internal = to_internal_error(error, path=scope["path"])
            self._client_api.refused("a2a", internal.code)
            trouble, id_ = trouble_of(internal), call.call.id
            if isinstance(error, _Malformed):
                trouble, id_ = error.trouble, id_ or error.id
            await refuse(send, trouble, place.binding, id_, wait=internal.retry_after)

    def _is_stop(self, session: Session, place: Place, call: _Asked, size: int) -> bool:
        """Return whether a request stops something; it then skips its caller's queue."""
        if size > SHORT:
            return False
        request = as_request(place, call.call.method, call.plain)
        return request is not None and self._client_api.is_stop(session, request)

    def _charge(self, session: Session, *, stops: bool) -> None:
        """Charge a request to the quota.

        :raises RateLimited: the quota is exceeded, and the request does not stop anything.
        """
        try:
            self._client_api.charge(session)
        except RateLimited:
            if not stops:
                raise

    async def _look(self, scope: Scope) -> tuple[int, RcpError | None]:
        """Return the maximum body length for the caller, and why the request is refused, if so.

        The body of a refused request is read for the request's id.
        """
        try:
            token = bearer(header(scope, b"authorization"))
            return self._client_api.longest(
                await self._client_api.identify(token, peer_of(scope))
            ), None
        except RcpError as error:
            return self._client_api.limits.unproved, error


class _Malformed(BadRequest):
    """An error that the SDK would not detect."""

    def __init__(self, trouble: Trouble, id_: str | int | None = None) -> None:
        super().__init__(trouble.message)
        self.trouble = trouble
        self.id = id_


def _check_type(scope: Scope) -> None:
    given = header(scope, b"content-type")
    if given is not None and given.partition(b";")[0].strip().lower() not in _TAKEN:
        text = "the body must be JSON: send `Content-Type: application/json`"
        reason = "CONTENT_TYPE_NOT_SUPPORTED"
        raise _Malformed(Trouble(415, "INVALID_ARGUMENT", reason, -32005, text))


def _check_state(scope: Scope, place: Place, call: _Call) -> None:
    """Refuse a filter with an unknown state, which the SDK would ignore."""
    named: str | int | None = None
    if call.method == "ListTasks":
        named = call.params.status
    elif place.rest == "/tasks":
        named = parse_qs(scope["query_string"].decode("latin-1")).get("status", [None])[-1]
    if isinstance(named, str) and named not in _STATES:
        text = f"unknown state '{named[:40]}': use one of {sorted(_STATES)}"
        trouble = Trouble(400, "INVALID_ARGUMENT", "INVALID_PARAMS", -32602, text)
        raise _Malformed(msgspec.structs.replace(trouble, http=_http(place, trouble)))


def _http(place: Place, trouble: Trouble) -> int:
    return 200 if place.binding == "jsonrpc" else trouble.http


def _read(scope: Scope, place: Place, body: bytes) -> _Asked:
    """Determine caller and tenant; refuse what is not JSON.

    The SDK is too lenient: it would store a `NaN` with the task, and could never encode it.
    """
    if not body and place.binding == "rest":
        return _Asked()
    try:
        plain = msgspec.json.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        text = f"the body is not JSON: {error}"
        trouble = Trouble(400, "INVALID_ARGUMENT", "INVALID_REQUEST", -32700, text)
        raise _Malformed(msgspec.structs.replace(trouble, http=_http(place, trouble))) from None
    values = _check_values(plain)
    if place.binding == "rest":
        return _Asked(plain=plain, values=values)
    try:
        call = msgspec.convert(plain, _Call)
    except msgspec.ValidationError:
        return _Asked(plain=plain, values=values)
    if "/" in call.method and (header(scope, b"a2a-version") or b"").startswith(b"1"):
        # Method names of 0.3 are not valid in the requested version.
        trouble = Trouble(200, "UNIMPLEMENTED", "METHOD_NOT_FOUND", -32601, "Method not found")
        raise _Malformed(trouble, call.id)
    return _Asked(call, plain, values)


def _check_values(plain: Any) -> int:
    """Count the values that the SDK has to process.

    :raises PayloadTooLarge: there are more than it can process in one turn of the loop.
    """
    count = count_values(plain, VALUES)
    if count > VALUES:
        raise PayloadTooLarge(
            f"the request has more than {VALUES} values",
            remedy="Send a long plan as text, a command in each line, or as several plans.",
            details={"limit": VALUES},
        )
    return count


def _tenant(place: Place, call: _Call) -> str | None:
    named = call.params.tenant or None
    if place.tenant is not None and named not in (None, place.tenant):
        raise Forbidden("the URL and the parameters name different tenants")
    return place.tenant or named


async def _not_here(request: Request, error: Exception) -> Response:
    """Return as JSON what the router would return as text."""
    answers: list[Any] = []

    async def send(message: Any) -> None:
        answers.append(message)

    missing = isinstance(error, HTTPException) and error.status_code == 404
    binding = "jsonrpc" if request.scope["path"] == "/" else "rest"
    await refuse(send, NOT_FOUND if missing else NOT_TAKEN, binding)
    head, body = answers
    response = Response(body["body"], head["status"])
    response.raw_headers = head["headers"]
    if isinstance(error, HTTPException) and (allow := (error.headers or {}).get("Allow")):
        response.headers["allow"] = allow
    return response


class _Exchange:
    """One request as the SDK sees it: the whole body at once, then the disconnect."""

    def __init__(
        self, client_api: ClientApi, scope: Scope, receive: Receive, send: Send, body: bytes
    ) -> None:
        self._client_api = client_api
        self._scope = scope
        self._receive = receive
        self._send = send
        self._body: bytes | None = body
        self._over = asyncio.Event()
        self._open = False
        """Whether the response has started and not ended."""

    async def run(self, app: Asgi) -> None:
        """Let the SDK serve; a stream ends with the client's credentials or the gateway."""
        closing: set[Any] = self._scope.get("extensions", {}).get("rcp.closing", set())
        keep = self._client_api.until_end(self._scope[CALLER].session, self._expired)
        closing.add(self._over.set)
        try:
            await app(self._scope, self._next, self._passed)
            if self._open and self._over.is_set():
                # The SDK treats this like a disconnect, and leaves the response incomplete.
                await self._send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            closing.discard(self._over.set)
            keep()

    async def _passed(self, message: Any) -> None:
        self._open = message["type"] != "http.response.body" or message.get("more_body", False)
        await self._send(message)

    def _expired(self, _error: RcpError) -> None:
        self._over.set()

    async def _next(self) -> Any:
        if self._body is not None:
            body, self._body = self._body, None
            return {"type": "http.request", "body": body, "more_body": False}
        over = asyncio.ensure_future(self._over.wait())
        left = asyncio.ensure_future(until_gone(self._receive))
        try:
            await asyncio.wait((over, left), return_when=asyncio.FIRST_COMPLETED)
        finally:
            over.cancel()
            left.cancel()
        return {"type": "http.disconnect"}
