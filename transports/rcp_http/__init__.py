"""HTTP requests under /rcp/v1: resources, envelopes, commands, catalogue, health."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_gateway.client_api import ClientApi, Mount
from rcp_gateway.client_kinds import TransportKind
from rcp_gateway.hookspecs import hookimpl
from rcp_http.config import HttpConfig

__all__ = ["HttpConfig", "open_http", "rcp_transports"]


@asynccontextmanager
async def open_http(config: HttpConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Mount the calls in the listener while entered."""
    from rcp_http.app import PREFIX, HttpApp
    from rcp_http.openapi import Described

    app = HttpApp(config, client_api)
    described = Described(client_api, app.calls)
    mount = Mount(name="http", prefix=PREFIX, app=app, openapi=described.part)
    client_api.mount(mount)
    try:
        yield {"path": PREFIX}
    finally:
        client_api.unmount(mount)


@hookimpl
def rcp_transports() -> Iterable[TransportKind]:
    """Provide HTTP."""
    return [TransportKind("http", HttpConfig, open_http, __doc__ or "")]
