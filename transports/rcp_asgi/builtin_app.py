"""What the listener answers itself: health, metrics, OpenAPI, and where to look."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from litestar import Controller, Response, get
from litestar.di import NamedDependency, Provide

from rcp_asgi.index import index_page
from rcp_asgi.openapi import Documents
from rcp_kernel.api import Session, SharedWork
from rcp_kernel.asgi import session_of
from rcp_kernel.client_api import Asgi, ClientApi
from rcp_kernel.errors import Forbidden, RcpError
from rcp_web.application import Application, Asked, scope_of

__all__ = ["OWN", "builtin_app"]

OWN = frozenset(
    ("/healthz", "/readyz", "/metrics", "/openapi.json", "/rcp/v1/openapi.json", "/rcp/v1")
)
"""Paths that no mount takes from the listener."""
_METRICS = "text/plain; version=0.0.4"


class Services(NamedTuple):
    """What the handlers use. One record, as Litestar begins a task for each of several dependencies."""

    client_api: ClientApi
    documents: Documents
    scrapes: SharedWork[bytes]

    async def session(self, request: Asked) -> Session:
        """Return the caller's session.

        :raises RcpError: as `session_of` does.
        """
        return await session_of(self.client_api, scope_of(request))

    async def sees_all(self, request: Asked) -> bool:
        """Tell whether the caller may see every tenant."""
        try:
            return "*" in (await self.session(request)).rights.tenants
        except RcpError:
            return False

    async def exposition(self, session: Session) -> bytes:
        """Write the metrics."""
        owner, turns = session.principal.identity, self.client_api.turns
        return await turns.finish(owner, self.client_api.metrics(session))


class Health(Controller):
    """Whether it lives, whether it is ready, and how it does."""

    @get("/healthz", sync_to_thread=False)
    def healthz(self) -> dict[str, str]:
        """Tell that the process lives."""
        return {"status": "ok"}

    @get("/readyz")
    async def readyz(
        self, request: Asked, services: NamedDependency[Services]
    ) -> Response[dict[str, Any]]:
        """Tell whether every backend is ready; which ones, to those who may see all tenants."""
        ready, states = services.client_api.ready()
        body: dict[str, Any] = {"ready": ready}
        if await services.sees_all(request):
            body["backends"] = states
        return Response(body, status_code=200 if ready else 503)

    @get("/metrics")
    async def metrics(
        self, session: NamedDependency[Session], services: NamedDependency[Services]
    ) -> Response[bytes]:
        """Write the Prometheus exposition: it names every tenant's robots."""
        if "*" not in session.rights.tenants:
            raise Forbidden("metrics need access to every tenant")
        services.client_api.charge(session)
        write = partial(services.exposition, session)
        text = await services.scrapes.result(session.rights, write)
        return Response(text, media_type=_METRICS)


class About(Controller):
    """What there is, for programs and for people."""

    @get(["/openapi.json", "/rcp/v1/openapi.json"])
    async def openapi(
        self, session: NamedDependency[Session], services: NamedDependency[Services]
    ) -> Response[bytes]:
        """Describe what the caller may see."""
        return Response(await services.documents.written(session), media_type="application/json")

    @get(["/", "/rcp/v1"], sync_to_thread=False)
    def index(self, request: Asked, services: NamedDependency[Services]) -> Response[str]:
        """Tell what this is and where to look."""
        html = "text/html" in request.headers.get("accept", "")
        media = "text/html" if html else "text/plain"
        return Response(index_page(services.client_api, html=html), media_type=media)


def builtin_app(client_api: ClientApi) -> Asgi:
    """Make the application."""
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


async def _session(request: Asked, services: NamedDependency[Services]) -> Session:
    return await services.session(request)
