"""/dashboard/api: from a URL to its handler; whatever goes wrong is an envelope."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from rcp_dashboard.camera import Cameras
from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.layouts import Layouts
from rcp_dashboard.request import DashboardRequest
from rcp_dashboard.telemetry import Telemetry
from rcp_kernel.api import to_internal_error
from rcp_kernel.asgi import Headers, Receive, Scope, Send, refuse, respond
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import UnknownPath, UnsupportedOperation

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
            "/camera": {"GET": lambda query, _, send: self._cameras.snapshot(query, send)},
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
            query = DashboardRequest(scope)
            if query.method == "OPTIONS":
                await respond(send, 204, b"", headers=[(b"allow", allowed)])
                return
            handler = handlers.get(query.method)
            if handler is None:
                headers.append((b"allow", allowed))
                raise UnsupportedOperation(
                    f"{path} does not support {query.method}",
                    remedy=f"Use {' or '.join(handlers)}.",
                )
            await query.identify(self._client_api)
            await handler(query, receive, sending)
        except Exception as error:
            if begun:
                raise
            failure = to_internal_error(error, path=path)
            self._client_api.refused("dashboard", failure.code)
            await refuse(send, failure, headers=headers)

    async def _series(self, query: DashboardRequest, _: Receive, send: Send) -> None:
        await respond(send, 200, await self._telemetry.series(query), headers=_NO_STORE)

    async def _latest(self, query: DashboardRequest, _: Receive, send: Send) -> None:
        await respond(send, 200, await self._telemetry.latest(query), headers=_NO_STORE)

    async def _layout(self, query: DashboardRequest, _: Receive, send: Send) -> None:
        query.allow()
        await respond(send, 200, self._layouts.get(query.principal), headers=_NO_STORE)

    async def _save(self, query: DashboardRequest, receive: Receive, send: Send) -> None:
        query.allow()
        self._layouts.put(query.principal, await query.body(receive, self._limit))
        await respond(send, 204, b"", headers=_NO_STORE)

    async def _forget(self, query: DashboardRequest, _: Receive, send: Send) -> None:
        query.allow()
        self._layouts.delete(query.principal)
        await respond(send, 204, b"", headers=_NO_STORE)

    def close(self) -> None:
        """Let go of everything."""
        self._telemetry.close()
        self._cameras.close()


def _allowed(handlers: dict[str, Handler]) -> bytes:
    return ", ".join((*handlers, "HEAD", "OPTIONS")).encode()
