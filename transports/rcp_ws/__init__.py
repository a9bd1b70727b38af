"""WebSocket at /rcp/v1/ws: envelopes in both directions, in JSON, CBOR or MessagePack."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_gateway.client_api import ClientApi, Mount
from rcp_gateway.client_kinds import TransportKind
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_web.asgi import Receive, Scope, Send, peer_of, refuse
from rcp_ws.client import WsClient
from rcp_ws.config import WsConfig
from rcp_ws.handshake import choose, identify

__all__ = ["WsConfig", "open_ws", "rcp_transports"]

_PATH = "/rcp/v1/ws"


class _WebSocket:
    """The ASGI application: attaches a client to the native handle and waits for its end."""

    def __init__(self, config: WsConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await receive()  # websocket.connect
        try:
            if scope["path"] != _PATH:
                raise UnsupportedOperation(f"the WebSocket is at {_PATH}")
            subprotocol, encoding = choose(scope["subprotocols"])
            socket = scope["extensions"]["rcp.socket"]
            who = await identify(self._client_api, scope)
            peer = WsClient(self._client_api, self._config, who, encoding, socket, peer_of(scope))
        except RcpError as error:
            self._client_api.refused("hello", error.code)

            async def denied(message: Any) -> None:
                await send({**message, "type": "websocket." + message["type"]})

            await refuse(denied, error)
            return
        socket.attach(peer)
        await send({"type": "websocket.accept", "subprotocol": subprotocol})
        peer.opened()
        await peer.gone.wait()


@asynccontextmanager
async def open_ws(config: WsConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Mount the WebSocket in the listener while entered."""
    mount = Mount(name="ws", prefix=_PATH, kind="websocket", app=_WebSocket(config, client_api))
    client_api.mount(mount)
    try:
        yield {"path": _PATH}
    finally:
        client_api.unmount(mount)


@hookimpl
def rcp_transports() -> Iterable[TransportKind]:
    """Provide WebSocket."""
    return [TransportKind("ws", WsConfig, open_ws, __doc__ or "")]
