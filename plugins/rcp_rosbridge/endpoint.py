"""Serves the WebSocket, at a path of the listener and at a port of its own."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import parse_qs

from rcp_gateway.api import Principal
from rcp_gateway.client_api import ClientApi, Mount
from rcp_kernel.errors import BadRequest, RcpError, Unauthenticated, UnsupportedOperation
from rcp_rosbridge.client import RosClient
from rcp_rosbridge.config import RosbridgeConfig
from rcp_rosbridge.dialects import Renderings
from rcp_rosbridge.graphs import Graphs
from rcp_web.asgi import Receive, Scope, Send, bearer, header, peer_of, refuse

__all__ = ["open_rosbridge"]

_TOKEN = "token"  # noqa: S105 - the name of a parameter


class _Endpoint:
    """The ASGI application: attaches a client to the native handle and waits for its end."""

    def __init__(self, config: RosbridgeConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api
        self._graphs = Graphs(client_api)
        self._renderings = Renderings(config.write_interval)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await receive()  # websocket.connect
        try:
            if scope["path"] not in (self._config.path, "/"):
                raise UnsupportedOperation(f"the WebSocket is at {self._config.path}")
            socket = scope["extensions"]["rcp.socket"]
            who = await self._identify(scope)
            client = RosClient(
                self._client_api,
                self._config,
                who,
                socket,
                peer_of(scope),
                self._graphs,
                self._renderings,
            )
        except RcpError as error:
            self._client_api.refused("hello", error.code)

            async def denied(message: Any) -> None:
                await send({**message, "type": "websocket." + message["type"]})

            await refuse(denied, error)
            return
        socket.attach(client)
        await send({"type": "websocket.accept", "subprotocol": None})
        client.opened()
        await client.gone.wait()

    async def _identify(self, scope: Scope) -> tuple[Principal | None, str | None]:
        """Return the caller and its tenant; None: it must authenticate by `auth`.

        :raises Unauthenticated: the token is invalid.
        """
        query = parse_qs(scope["query_string"].decode("latin-1"))
        token = bearer(header(scope, b"authorization"))
        if token is None and self._config.token_in_url:
            token = _one(query, _TOKEN)
        try:
            principal = await self._client_api.identify(token, peer_of(scope))
        except Unauthenticated:
            if token is not None:
                raise
            principal = None
        return principal, _one(query, "tenant") or self._config.tenant


def _one(query: dict[str, list[str]], name: str) -> str | None:
    values = query.get(name, [])
    if len(values) > 1:
        raise BadRequest(f"the URL has `{name}` {len(values)} times")
    return values[0] if values else None


@asynccontextmanager
async def open_rosbridge(
    config: RosbridgeConfig, client_api: ClientApi
) -> AsyncGenerator[dict[str, Any]]:
    """Mount the WebSocket in the listener while entered."""
    app = _Endpoint(config, client_api)
    secrets = frozenset((_TOKEN,) if config.token_in_url else ())
    mounts = [
        Mount(name="rosbridge", prefix=config.path, kind="websocket", app=app, url_secrets=secrets)
    ]
    if config.port is not None:
        mounts.append(
            Mount(
                name="rosbridge",
                prefix="/",
                kind="websocket",
                app=app,
                port=config.port,
                url_secrets=secrets,
            )
        )
    facts: dict[str, Any] = {"path": config.path}
    if config.port:
        facts["port"] = config.port
    mounted: list[Mount] = []
    try:
        for mount in mounts:
            client_api.mount(mount)
            mounted.append(mount)
        yield facts
    finally:
        for mount in mounted:
            client_api.unmount(mount)
