"""The endpoint: from a handshake to a client, and what all clients share."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import parse_qs

from rcp_foxglove.client import FoxgloveClient
from rcp_foxglove.config import FoxgloveConfig, check
from rcp_foxglove.server_info import ServerInfo
from rcp_foxglove.views import Views
from rcp_gateway.api import Peer, Principal
from rcp_gateway.client_api import ClientApi, Mount
from rcp_kernel.clock import now
from rcp_kernel.errors import BadRequest, RcpError
from rcp_web.asgi import Receive, Scope, Send, bearer, header, peer_of, refuse

__all__ = ["SUBPROTOCOLS", "open_foxglove"]

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
_LOOK = 0.25  # s between two looks at the tree


class Endpoint:
    """The ASGI application."""

    def __init__(self, config: FoxgloveConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api
        self._views = Views(config, client_api)
        self._info = ServerInfo(client_api.title, timed=config.time > 0)
        self.clients: set[FoxgloveClient] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one client until it is gone."""
        await receive()  # websocket.connect
        try:
            subprotocol = _choose(scope["subprotocols"])
            who = await self._identify(scope)
            socket = scope["extensions"]["rcp.socket"]
            client = FoxgloveClient(
                self._client_api, self._config, self._views, self._info, who, socket
            )
        except RcpError as error:
            self._client_api.refused("hello", error.code)

            async def denied(message: Any) -> None:
                await send({**message, "type": "websocket." + message["type"]})

            await refuse(denied, error)
            return
        await self._serve(client, socket, subprotocol, send)

    async def _serve(
        self, client: FoxgloveClient, socket: Any, subprotocol: str, send: Send
    ) -> None:
        socket.attach(client)
        self.clients.add(client)
        try:
            view = await self._views.view(client.connection.session)
            client.playback.states = subprotocol == SUBPROTOCOLS[0]
            await client.playback.renew(view)
            await send({"type": "websocket.accept", "subprotocol": subprotocol})
            client.opened(view)
            await client.gone.wait()
        finally:
            self.clients.discard(client)
            client.connection.close(resumable=False)

    async def _identify(self, scope: Scope) -> tuple[Principal, str | None, Peer]:
        """Return who connects, and the tenant that the URL names."""
        token = bearer(header(scope, b"authorization"))
        if token is None and self._config.token_in_url:
            query = parse_qs(scope["query_string"].decode("latin-1"))
            token = query.get("token", [None])[0]
        peer = peer_of(scope)
        principal = await self._client_api.identify(token, peer)
        return principal, self._tenant(scope["path"]), peer

    def _tenant(self, path: str) -> str | None:
        """Return the tenant that a URL names after the endpoint's path, or after `/`."""
        prefix = self._config.path
        if path == prefix or path.startswith(prefix + "/"):
            path = path[len(prefix) :]
        return path.strip("/") or None

    async def look(self) -> None:
        """Have each client look at its view of the tree, periodically."""
        while True:
            await asyncio.sleep(_LOOK)
            for client in list(self.clients):
                client.look()

    async def tell_time(self) -> None:
        """Send the time at the configured rate."""
        while True:
            await asyncio.sleep(1 / self._config.time)
            moment = now()
            for client in list(self.clients):
                client.send_time(moment)


def _choose(offered: list[str]) -> str:
    """Choose the client's first supported subprotocol.

    :raises BadRequest: none of those offered is supported.
    """
    for name in offered:
        if name in SUBPROTOCOLS:
            return name
    raise BadRequest(
        "this is a Foxglove WebSocket: none of its subprotocols was offered",
        remedy=f"Offer {' or '.join(SUBPROTOCOLS)}.",
    )


@asynccontextmanager
async def open_foxglove(
    config: FoxgloveConfig, client_api: ClientApi
) -> AsyncGenerator[dict[str, Any]]:
    """Serve clients while entered."""
    check(config)
    endpoint = Endpoint(config, client_api)
    secret = frozenset(("token",) if config.token_in_url else ())
    mounts = [
        Mount(
            name="foxglove",
            prefix=config.path,
            kind="websocket",
            app=endpoint,
            url_secrets=secret,
        )
    ]
    if config.port is not None:
        mounts.append(
            Mount(
                name="foxglove",
                prefix="/",
                kind="websocket",
                app=endpoint,
                port=config.port,
                url_secrets=secret,
            )
        )
    mounted: list[Mount] = []
    tasks = [asyncio.create_task(endpoint.look(), name="foxglove views")]
    if config.time:
        tasks.append(asyncio.create_task(endpoint.tell_time(), name="foxglove time"))
    try:
        for mount in mounts:
            client_api.mount(mount)
            mounted.append(mount)
        yield {"path": config.path}
    finally:
        for mount in mounted:
            client_api.unmount(mount)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
