"""The listener's own pages: health, metrics, OpenAPI and the index."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from litestar import Controller, Response, get
from litestar.di import NamedDependency, Provide

from rcp_asgi.index import index_page
from rcp_asgi.openapi import Documents
from rcp_gateway.api import Session, SharedWork
from rcp_gateway.client_api import Asgi, ClientApi
from rcp_kernel.errors import Forbidden, RcpError
from rcp_web.application import Application, WebRequest, scope_of
from rcp_web.asgi import session_of

__all__ = ["OWN", "builtin_app"]

OWN = frozenset(
    ("/healthz", "/readyz", "/metrics", "/openapi.json", "/rcp/v1/openapi.json", "/rcp/v1")
)
"""Paths that mounts cannot take over."""
_METRICS = "text/plain; version=0.0.4"


class Services(NamedTuple):
    """The handlers' collaborators, in one record: Litestar starts a task per dependency."""

    client_api: ClientApi
    documents: Documents
    scrapes: SharedWork[bytes]

    async def session(self, request: WebRequest) -> Session:
        """Return the caller's session.

        :raises RcpError: see `session_of`.
        """
        return await session_of(self.client_api, scope_of(request))

    async def sees_all(self, request: WebRequest) -> bool:
        """Return whether the caller may see every tenant."""
        try:
            return "*" in (await self.session(request)).rights.tenants
        except RcpError:
            return False

    async def exposition(self, session: Session) -> bytes:
        """Return the metrics in Prometheus format."""
        owner, turns = session.principal.identity, self.client_api.turns
        return await turns.finish(owner, self.client_api.metrics(session))


class Health(Controller):
    """Liveness, readiness and metrics."""

    @get("/healthz", sync_to_thread=False)
    def healthz(self) -> dict[str, str]:
        """Report that the process is alive."""
        return {"status": "ok"}

    @get("/readyz")
    async def readyz(
        self, request: WebRequest, services: NamedDependency[Services]
    ) -> Response[dict[str, Any]]:
        """Report whether every backend is ready; lists them for callers who may see all tenants."""
        ready, states = services.client_api.ready()
        body: dict[str, Any] = {"ready": ready}
        if await services.sees_all(request):
            body["backends"] = states
        return Response(body, status_code=200 if ready else 503)

    @get("/metrics")
    async def metrics(
        self, session: NamedDependency[Session], services: NamedDependency[Services]
    ) -> Response[bytes]:
        """Return the Prometheus metrics, which name every tenant's robots."""
        if "*" not in session.rights.tenants:
            raise Forbidden("metrics need access to every tenant")
        services.client_api.charge(session)
        write = partial(services.exposition, session)
        text = await services.scrapes.result(session.rights, write)
        return Response(text, media_type=_METRICS)


class About(Controller):
    """The OpenAPI document and the index."""

    @get(["/openapi.json", "/rcp/v1/openapi.json"])
    async def openapi(
        self, session: NamedDependency[Session], services: NamedDependency[Services]
    ) -> Response[bytes]:
        """Return the OpenAPI document as the caller sees it."""
        return Response(await services.documents.written(session), media_type="application/json")

    @get(["/", "/rcp/v1"], sync_to_thread=False)
    def index(self, request: WebRequest, services: NamedDependency[Services]) -> Response[str]:
        """Return the index page."""
        html = "text/html" in request.headers.get("accept", "")
        media = "text/html" if html else "text/plain"
        return Response(index_page(services.client_api, html=html), media_type=media)


def builtin_app(client_api: ClientApi) -> Asgi:
    """Build the application."""
    made = Services(client_api, Documents(client_api), SharedWork[bytes](client_api.loop))

    def services() -> Services:
        return made

    return Application(
        [Health, About],
        dependencies={
            "services": Provide(services, sync_to_thread=False),
            "session": Provide(_session),
        },
        remedy="See `/` or /rcp/v1/openapi.json.",
    )


async def _session(request: WebRequest, services: NamedDependency[Services]) -> Session:
    return await services.session(request)
