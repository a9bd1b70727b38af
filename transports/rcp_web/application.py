"""Litestar as an ASGI application for a `Mount`: exact routes, errors as envelopes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

from litestar import Litestar, Request, Response
from litestar.di import Provide
from litestar.exceptions import HTTPException, MethodNotAllowedException, NotFoundException
from litestar.openapi.config import OpenAPIConfig
from litestar.openapi.plugins import JsonRenderPlugin
from litestar.types import ASGIApp, ControllerRouterHandler

from rcp_gateway.api import to_internal_error
from rcp_kernel.errors import BadRequest, RcpError, UnknownPath
from rcp_web.asgi import JSON, Receive, Scope, Send, respond
from rcp_web.refusals import NotTaken, Refusal, envelope, headers_of

__all__ = ["Application", "WebRequest", "response", "scope_of"]

WebRequest = Request[Any, Any, Any]
_ORDER = ("GET", "PUT", "POST", "DELETE", "HEAD", "OPTIONS")


class Application:
    """Serves controllers.

    Litestar serves `/a/` as `/a` and requires separate handlers for `HEAD`. Here paths must match
    exactly, and `HEAD` is a `GET` whose body the listener omits.
    """

    def __init__(
        self,
        handlers: Sequence[ControllerRouterHandler],
        *,
        remedy: str,
        refuse: Callable[[Scope, RcpError], Refusal] = envelope,
        dependencies: Mapping[str, Provide] | None = None,
        described: bool = False,
    ) -> None:
        """Initialise; `remedy` is for unknown paths, `described` for `paths`."""
        self._refuse = refuse
        self._remedy = remedy
        # Litestar needs routes to build a document; no mount prefix leads to this one.
        document = OpenAPIConfig("", "", path=_NOWHERE, render_plugins=[JsonRenderPlugin()])
        self._litestar = Litestar(
            handlers,
            dependencies=dependencies,
            exception_handlers={Exception: self._answer},
            openapi_config=document if described else None,
            logging_config=None,
        )

    def paths(self) -> dict[str, Any]:
        """Return the paths of the OpenAPI document that Litestar generates."""
        return dict(self._litestar.openapi_schema.to_schema()["paths"])

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        path, method = scope["path"], scope["method"]
        inner = {**scope, "root_path": ""}  # the listener has removed it from the path
        if path != "/" and (path[-1:] == "/" or "//" in path):
            inner["path"] = _NOT_SERVED
        if method == "HEAD":
            inner["method"] = "GET"
        elif method == "OPTIONS":
            inner["method"] = _NO_METHOD  # the error lists the methods of every handler of the path
        inner[_ASKED] = scope
        await self._litestar(cast("Any", inner), receive, cast("Any", send))

    def _answer(self, request: WebRequest, error: Exception) -> Response[bytes]:
        scope = scope_of(request)
        told = self._told(scope, error)
        if scope["method"] == "OPTIONS" and isinstance(told, NotTaken):
            return Response(b"", status_code=204, headers={"allow": ", ".join(told.methods)})
        body, media, headers = self._refuse(scope, told)
        fields = {k.decode(): v.decode("latin-1") for k, v in (*headers, *headers_of(told))}
        return Response(body, status_code=told.http, media_type=media.decode(), headers=fields)

    def _told(self, scope: Scope, error: Exception) -> RcpError:
        path = scope["path"]
        if isinstance(error, NotFoundException):
            return UnknownPath(f"nothing found at {path}", remedy=self._remedy)
        if isinstance(error, MethodNotAllowedException):
            named = (error.headers or {}).get("allow", "")
            return NotTaken(path, scope["method"], _methods(named.split(", ")))
        if isinstance(error, HTTPException) and error.status_code < 500:
            return BadRequest(error.detail or "the request is malformed")
        return to_internal_error(error, path=path)


_ASKED = "rcp.asked"
"""Key of the original scope, of which Litestar gets a modified copy."""
_NOWHERE = "/-/openapi"
_NOT_SERVED = "/-/-"
_NO_METHOD = "-"


def scope_of(request: WebRequest) -> Scope:
    """Return the scope as the listener built it."""
    return cast("Any", request.scope)[_ASKED]


def response(
    status: int, body: bytes = b"", media: bytes = JSON, headers: Iterable[tuple[bytes, bytes]] = ()
) -> ASGIApp:
    """Return a handler's result as a complete response: Litestar's own is slower."""

    async def send_it(_scope: Any, _receive: Any, send: Any) -> None:
        await respond(send, status, body, media, headers)

    return send_it


def _methods(named: Iterable[str]) -> list[str]:
    known = {name.strip() for name in named}
    if "GET" in known:
        known.add("HEAD")
    return [name for name in _ORDER if name in known]
