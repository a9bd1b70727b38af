"""The dashboard at `/`: pages for people, and telemetry ready to be drawn under /dashboard/api."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.pages import Pages
from rcp_kernel.door import Door, Mount
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.spi import AdapterKind

__all__ = ["DashboardConfig", "open_dashboard", "rcp_adapters"]


@asynccontextmanager
async def open_dashboard(_: DashboardConfig, door: Door) -> AsyncGenerator[dict[str, Any]]:
    """Offer the pages to the listener while entered."""
    pages = Pages()
    mount = Mount(name="dashboard", prefix="/", app=pages)
    door.mount(mount)
    try:
        yield {"path": "/", **pages.facts()}
    finally:
        door.unmount(mount)


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Offer the dashboard."""
    return [AdapterKind("dashboard", DashboardConfig, open_dashboard, __doc__ or "")]
