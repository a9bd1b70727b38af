"""The dashboard at `/`: pages for people, and telemetry ready to be drawn under /dashboard/api."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_dashboard.config import DashboardConfig
from rcp_gateway.client_api import ClientApi, Mount
from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl

__all__ = ["DashboardConfig", "open_dashboard", "rcp_adapters"]


@asynccontextmanager
async def open_dashboard(
    config: DashboardConfig, client_api: ClientApi
) -> AsyncGenerator[dict[str, Any]]:
    """Mount the pages and the API in the listener while entered."""
    from rcp_dashboard.api import PREFIX, Api
    from rcp_dashboard.pages import STATIC, Pages
    from rcp_dashboard.panels import PREFIX as PANELS
    from rcp_dashboard.panels import Panels
    from rcp_dashboard.tiles import PREFIX as MAP
    from rcp_dashboard.tiles import Tiles

    pages = Pages(STATIC)
    panels = Panels(config.panels)
    tiles = Tiles(config.tiles)
    api = Api(client_api, config, panels.encoded())
    mounts = (
        Mount(name="dashboard", prefix="/", app=pages.app),
        Mount(name="dashboard panels", prefix=PANELS, app=panels.app),
        Mount(name="dashboard map", prefix=MAP, app=tiles.app),
        Mount(name="dashboard api", prefix=PREFIX, app=api.app, openapi=api.openapi),
    )
    for mount in mounts:
        client_api.mount(mount)
    try:
        yield {"path": "/", **pages.facts()}
    finally:
        for mount in mounts:
            client_api.unmount(mount)
        api.close()


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide the dashboard."""
    wants = ("numpy", "simplejpeg")  # JPEGs of raw images
    return [AdapterKind("dashboard", DashboardConfig, open_dashboard, __doc__ or "", wants=wants)]
