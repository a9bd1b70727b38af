"""What the listener answers itself: health, metrics, OpenAPI, and where to look. Litestar's part."""

from __future__ import annotations

from typing import Any, cast

from litestar import Litestar, Request, Response, get
from litestar.datastructures import State
from litestar.exceptions import HTTPException, MethodNotAllowedException, NotFoundException

from rcp_asgi.index import index_page
from rcp_asgi.openapi import Documents
from rcp_kernel.api import Session, SharedWork
from rcp_kernel.asgi import Receive, Scope, Send, retry_after, session_of, status_of
from rcp_kernel.client_api import Asgi, ClientApi
from rcp_kernel.errors import (
    BadRequest,
    Forbidden,
    InternalError,
    RcpError,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure

__all__ = ["OWN", "builtin_app"]

OWN = frozenset(
    ("/healthz", "/readyz", "/metrics", "/openapi.json", "/rcp/v1/openapi.json", "/rcp/v1")
)
"""Paths that no mount takes from the listener."""
_METRICS = "text/plain; version=0.0.4"
Asked = Request[Any, Any, State]


def builtin_app(client_api: ClientApi) -> Asgi:
    """Make the application."""
    documents = Documents(client_api)
    scrapes = SharedWork[bytes](client_api.loop)

    @get("/healthz", sync_to_thread=False)
    def healthz() -> dict[str, str]:
        """Tell that the process lives."""
        return {"status": "ok"}

    @get("/readyz")
    async def readyz(request: Asked) -> Response[dict[str, Any]]:
        """Tell whether every backend is ready; which ones, to those who may see all tenants."""
        ready, states = client_api.ready()
        body: dict[str, Any] = {"ready": ready}
        if await _sees_all(client_api, request):
            body["backends"] = states
        return Response(body, status_code=200 if ready else 503)

    @get("/metrics")
    async def metrics(request: Asked) -> Response[bytes]:
        """Write the Prometheus exposition: it names every tenant's robots."""
        if not await _sees_all(client_api, request):
            await _session(client_api, request)  # 401 for those who did not say who they are
            raise Forbidden("metrics need access to every tenant")
        session = await _session(client_api, request)
        client_api.charge(session)
        text = await scrapes.result(session.rights, lambda: _exposition(client_api, session))
        return Response(text, media_type=_METRICS)

    @get(["/openapi.json", "/rcp/v1/openapi.json"])
    async def openapi(request: Asked) -> Response[bytes]:
        """Describe what the caller may see."""
        document = await documents.written(await _session(client_api, request))
        return Response(document, media_type="application/json")

    @get(["/", "/rcp/v1"], sync_to_thread=False)
    def index(request: Asked) -> Response[str]:
        """Tell what this is and where to look."""
        html = "text/html" in request.headers.get("accept", "")
        media = "text/html" if html else "text/plain"
        return Response(index_page(client_api, html=html), media_type=media)

    made = Litestar(
        [healthz, readyz, metrics, openapi, index],
        openapi_config=None,
        logging_config=None,
        exception_handlers={Exception: _refused},
    )

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] == "HEAD":  # the listener leaves the body out
            scope = {**scope, "method": "GET"}
        await made(cast("Any", scope), receive, cast("Any", send))

    return app


async def _session(client_api: ClientApi, request: Asked) -> Session:
    return await session_of(client_api, cast("Scope", request.scope))


async def _exposition(client_api: ClientApi, session: Session) -> bytes:
    owner = session.principal.identity
    return await client_api.turns.finish(owner, client_api.metrics(session))


async def _sees_all(client_api: ClientApi, request: Asked) -> bool:
    try:
        return "*" in (await _session(client_api, request)).rights.tenants
    except RcpError:
        return False


def _refused(request: Asked, error: Exception) -> Response[bytes]:
    told = _told(request, error)
    reply = failure(told, "error")
    headers = {"www-authenticate": "Bearer"} if told.http == 401 else {}
    headers |= {key.decode(): value.decode() for key, value in retry_after(told.retry_after)}
    if isinstance(error, MethodNotAllowedException):
        headers["allow"] = "GET, HEAD, OPTIONS"
    body = encode_reply(reply, Encoding.JSON)
    return Response(
        body, status_code=status_of(reply), media_type="application/json", headers=headers
    )


def _told(request: Asked, error: Exception) -> RcpError:
    if isinstance(error, RcpError):
        return error
    path = request.scope["path"]
    if isinstance(error, NotFoundException):
        return UnknownPath(f"nothing found at {path}", remedy="See `/` or /rcp/v1/openapi.json.")
    if isinstance(error, MethodNotAllowedException):
        return UnsupportedOperation(f"{path} does not support {request.method}")
    if isinstance(error, HTTPException) and error.status_code < 500:
        return BadRequest(error.detail or "the request is malformed")
    return InternalError("the gateway failed to handle the request")
