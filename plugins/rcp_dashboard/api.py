"""/dashboard/api: telemetry, cameras and panels, with the parameters and responses of all calls."""

from __future__ import annotations

from typing import Any

from litestar import Controller, Router, get
from litestar.di import NamedDependency, Provide
from litestar.types import ASGIApp

from rcp_dashboard.camera import Cameras
from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.past import Past
from rcp_dashboard.request import DashboardRequest
from rcp_dashboard.schemas import CAMERA, LATEST, PANELS, PAST, SERIES, STREAM, answer
from rcp_dashboard.telemetry import Telemetry
from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import RcpError
from rcp_web.application import Application, WebRequest, response, scope_of
from rcp_web.asgi import Headers, Scope
from rcp_web.calls import call, parameters_of, query
from rcp_web.refusals import Refusal, envelope

__all__ = ["PREFIX", "Api"]

PREFIX = "/dashboard/api"
_NO_STORE: Headers = [(b"cache-control", b"no-store")]
_INTEGER = {"type": "integer"}
_NUMBER = {"type": "number"}
_TEXT = {"type": "string"}
_PATH = query("path", _TEXT, "A resource.", required=True)
_QUALITY = query("quality", _INTEGER, "Quality of JPEGs converted from raw pixels, 1 to 100.")


class Services:
    """The handlers' collaborators."""

    def __init__(self, client_api: ClientApi, config: DashboardConfig, panels: bytes) -> None:
        self.client_api = client_api
        self.panels = panels
        self.telemetry = Telemetry(client_api, config)
        self.past = Past(client_api)
        self.cameras = Cameras(client_api, config)


class Values(Controller):
    """The values to draw."""

    tags = ("dashboard",)

    @get(
        "/series",
        **call(
            "Fields over time, down-sampled.",
            _PATH,
            query("field", {"type": "array", "items": _TEXT}, "A numeric field; repeatable."),
            query("window", _NUMBER, "Length of the window before `until`, in s."),
            query(
                "until",
                _TEXT,
                "End of the window, ISO 8601 or s since the epoch. Default: the newest sample.",
            ),
            query("points", _INTEGER, "Maximum number of points, 4 to 5000. Default: 600."),
            query("method", _TEXT, "`minmax` (no extreme is lost) or `lttb`."),
            responses=answer("Fields over time, down-sampled.", SERIES),
        ),
    )
    async def series(
        self, asked: NamedDependency[DashboardRequest], services: NamedDependency[Services]
    ) -> ASGIApp:
        """Answer with fields of a resource over time."""
        return response(200, await services.telemetry.series(asked), headers=_NO_STORE)

    @get(
        "/latest",
        **call(
            "Current values.",
            query("path", _TEXT, "A path or pattern.", required=True),
            query(
                "max_bytes",
                _INTEGER,
                "Maximum bytes per value; longer ones are omitted. Default: 4096.",
            ),
            query("cursor", _TEXT, "`cursor` from the previous reply, if it was `truncated`."),
            responses=answer("Current values.", LATEST),
        ),
    )
    async def latest(
        self, asked: NamedDependency[DashboardRequest], services: NamedDependency[Services]
    ) -> ASGIApp:
        """Answer with the current values of resources."""
        return response(200, await services.telemetry.latest(asked), headers=_NO_STORE)

    @get(
        "/past",
        **call(
            "Recorded samples of several resources.",
            query("path", {"type": "array", "items": _TEXT}, "A resource; repeatable, 1 to 64."),
            query("from", _TEXT, "The first moment, ISO 8601 or s since the epoch.", required=True),
            query("to", _TEXT, "The end, which is not a part of it. Default: now."),
            query("before", _INTEGER, "Samples of each resource before `from`, 0 to 200."),
            query("every", _NUMBER, "Only the first sample of each interval of so many seconds."),
            query("cursor", _TEXT, "`cursor` from the previous page."),
            responses=answer("Recorded samples, one page of them.", PAST),
        ),
    )
    async def past(
        self, asked: NamedDependency[DashboardRequest], services: NamedDependency[Services]
    ) -> ASGIApp:
        """Answer with what was recorded, as the process that reads it writes it."""
        return response(200, await services.past.page(asked), headers=_NO_STORE)

    @get(
        "/camera",
        **call("The latest image.", _PATH, _QUALITY, responses=answer("The latest image.", CAMERA)),
    )
    async def camera(
        self, asked: NamedDependency[DashboardRequest], services: NamedDependency[Services]
    ) -> ASGIApp:
        """Answer with an image."""
        return await services.cameras.snapshot(asked)

    @get(
        "/camera/stream",
        **call(
            "Images, until one side closes the connection.",
            _PATH,
            _QUALITY,
            query("rate", _NUMBER, "Maximum images per second."),
            responses=answer("Images, until one side closes the connection.", STREAM),
        ),
    )
    async def stream(
        self, asked: NamedDependency[DashboardRequest], services: NamedDependency[Services]
    ) -> ASGIApp:
        """Stream images, bypassing Litestar."""

        async def send_them(_scope: Any, receive: Any, send: Any) -> None:
            await services.cameras.stream(asked, receive, send)

        return send_them


class Extensions(Controller):
    """What plugins add to the page."""

    tags = ("dashboard",)

    @get("/panels", **call("Panels of plugins.", responses=answer("Panels of plugins.", PANELS)))
    async def panels(
        self, asked: NamedDependency[DashboardRequest], services: NamedDependency[Services]
    ) -> ASGIApp:
        """Answer with the panels of plugins, and what they read and write."""
        return response(200, services.panels, headers=_NO_STORE)


class Api:
    """Serves and describes the calls."""

    def __init__(self, client_api: ClientApi, config: DashboardConfig, panels: bytes) -> None:
        self._client_api = client_api
        self._services = Services(client_api, config, panels)
        self.app = Application(
            [Router(PREFIX, route_handlers=[Values, Extensions])],
            dependencies={
                "services": Provide(self._get_services, sync_to_thread=False),
                "asked": Provide(_identify),
            },
            refuse=self._refuse,
            remedy=f"Available: {', '.join(PREFIX + rest for rest in _PLACES)}.",
            described=True,
        )

    def _get_services(self) -> Services:
        return self._services

    async def openapi(self, _: Session) -> dict[str, Any]:
        """Describe the calls; they are the same for every caller."""
        return {"paths": self.app.paths()}

    def _refuse(self, scope: Scope, error: RcpError) -> Refusal:
        self._client_api.refused("dashboard", error.code)
        return envelope(scope, error)._replace(headers=tuple(_NO_STORE))

    def close(self) -> None:
        """Release everything."""
        self._services.telemetry.close()
        self._services.cameras.close()


_PLACES = ("/series", "/latest", "/past", "/camera", "/camera/stream", "/panels")


async def _identify(request: WebRequest, services: NamedDependency[Services]) -> DashboardRequest:
    asked = DashboardRequest(scope_of(request))
    await asked.identify(services.client_api)
    asked.allow(*parameters_of(request))
    return asked
