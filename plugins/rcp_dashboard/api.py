"""/dashboard/api: from a URL to its handler; whatever goes wrong is an envelope."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from rcp_dashboard.camera import Cameras
from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.layouts import Layouts
from rcp_dashboard.request import DashboardRequest
from rcp_dashboard.telemetry import Telemetry
from rcp_kernel.asgi import Headers, Receive, Scope, Send, refuse, respond
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import UnknownPath, UnsupportedOperation
from rcp_kernel.operations.pending import to_internal_error

__all__ = ["PREFIX", "Api"]

PREFIX = "/dashboard/api"
_NO_STORE: Headers = [(b"cache-control", b"no-store")]
Handler = Callable[[DashboardRequest, Receive, Send], Awaitable[None]]


class Api:
    """Serves it."""

    def __init__(self, client_api: ClientApi, config: DashboardConfig, layouts: Layouts) -> None:
        self._client_api = client_api
        self._limit = config.layout_size
        self._telemetry = Telemetry(client_api, config)
        self._cameras = Cameras(client_api, config)
        self._layouts = layouts
        self._handlers: dict[str, dict[str, Handler]] = {
            "/series": {"GET": self._series},
            "/latest": {"GET": self._latest},
            "/camera": {"GET": lambda asked, _, send: self._cameras.snapshot(asked, send)},
            "/camera/stream": {"GET": self._cameras.stream},
            "/layout": {"GET": self._layout, "PUT": self._save, "DELETE": self._forget},
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        path: str = scope["path"]
        headers: Headers = [*_NO_STORE]
        begun = False

        async def sending(message: dict[str, object]) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            handlers = self._handlers.get(path.removeprefix(PREFIX))
            if handlers is None:
                known = ", ".join(PREFIX + rest for rest in self._handlers)
                raise UnknownPath(f"nothing found at {path}", remedy=f"Available: {known}.")
            allowed = _allowed(handlers)
            asked = DashboardRequest(scope)
            if asked.method == "OPTIONS":
                await respond(send, 204, b"", headers=[(b"allow", allowed)])
                return
            handler = handlers.get(asked.method)
            if handler is None:
                headers.append((b"allow", allowed))
                raise UnsupportedOperation(
                    f"{path} does not support {asked.method}",
                    remedy=f"Use {' or '.join(handlers)}.",
                )
            await asked.identify(self._client_api)
            await handler(asked, receive, sending)
        except Exception as error:
            if begun:
                raise
            told = to_internal_error(error, path=path)
            self._client_api.refused("dashboard", told.code)
            await refuse(send, told, headers=headers)

    async def _series(self, asked: DashboardRequest, _: Receive, send: Send) -> None:
        await respond(send, 200, await self._telemetry.series(asked), headers=_NO_STORE)

    async def _latest(self, asked: DashboardRequest, _: Receive, send: Send) -> None:
        await respond(send, 200, await self._telemetry.latest(asked), headers=_NO_STORE)

    async def _layout(self, asked: DashboardRequest, _: Receive, send: Send) -> None:
        asked.allow()
        await respond(send, 200, self._layouts.get(asked.principal), headers=_NO_STORE)

    async def _save(self, asked: DashboardRequest, receive: Receive, send: Send) -> None:
        asked.allow()
        self._layouts.put(asked.principal, await asked.body(receive, self._limit))
        await respond(send, 204, b"", headers=_NO_STORE)

    async def _forget(self, asked: DashboardRequest, _: Receive, send: Send) -> None:
        asked.allow()
        self._layouts.delete(asked.principal)
        await respond(send, 204, b"", headers=_NO_STORE)

    def close(self) -> None:
        """Let go of everything."""
        self._telemetry.close()
        self._cameras.close()


def _allowed(handlers: dict[str, Handler]) -> bytes:
    return ", ".join((*handlers, "HEAD", "OPTIONS")).encode()
