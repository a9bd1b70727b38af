"""The router of all requests: a dictionary lookup and a few prefixes, before any framework.

Mounts can be added and removed while the gateway runs; the table is then rebuilt.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import structlog

from rcp_asgi.cors import allowing, is_preflight, preflight
from rcp_asgi.login_cookie import apply_login
from rcp_asgi.origins import Origins
from rcp_asgi.request_head import METHODS
from rcp_asgi.urls import check_url
from rcp_gateway.client_api import Asgi, ClientApi, Mount
from rcp_kernel.errors import AdapterUnavailable, BadRequest, Forbidden, InternalError, UnknownPath
from rcp_web.asgi import Receive, Scope, Send, refuse, respond

__all__ = ["MountRouter"]

log = structlog.get_logger("rcp.asgi")
_NONE: frozenset[str] = frozenset()
_Served = tuple[str, str, Asgi, frozenset[str]]
"""Prefix, suffix, application, and the parameters of its URLs that may be secrets."""


class MountRouter:
    """The ASGI application that the server calls."""

    def __init__(
        self,
        client_api: ClientApi,
        origins: Origins,
        house: Asgi,
        own: frozenset[str],
        root_path: str,
        port: int | None = None,
    ) -> None:
        """Serve the mounts of a `port` of their own; None: those of the listener's."""
        self._port = port
        self._client_api = client_api
        self._origins = origins
        self._house = house
        self._own = own
        """Paths served by the listener itself, regardless of mounts."""
        self._root = root_path
        self._seen: list[Mount] = []
        self._tables: dict[str, dict[str, list[_Served]]] = {
            kind: {"": []} for kind in ("http", "websocket")
        }
        """Mounts by the first segment of their prefix, and by "" for paths with no other; in the
        order in which they are tried."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or WebSocket."""
        try:
            origin = self._origins.check(scope)
            if self._root:
                self._strip(scope)
            app, secrets = self._find(scope["type"], scope["path"])
            check_url(scope, secrets)
            if origin is None:
                apply_login(self._client_api, scope)
        except (Forbidden, BadRequest) as error:
            self._client_api.refused("request", error.code)
            await _turn_away(scope, receive, send, error)
            return
        if origin is not None and scope["type"] == "http":
            if is_preflight(scope):
                await preflight(scope, send, origin)
                return
            send = allowing(send, origin)
        if scope["path"] == "*":  # OPTIONS of the gateway as a whole (RFC 9110, 9.3.7)
            await respond(send, 204, b"", headers=[(b"allow", METHODS)])
            return
        if app is None:
            await _turn_away(scope, receive, send, UnknownPath(f"nothing found at {scope['path']}"))
            return
        try:
            await app(scope, receive, send)
        except Exception:
            log.exception("mount_failed", path=scope["path"])
            if scope["type"] == "websocket":
                raise
            # A response that has started cannot be revoked: the server closes the connection.
            failed = InternalError("the gateway failed to handle the request; see its log")
            await refuse(send, failed)

    def _strip(self, scope: Scope) -> None:
        path = scope["path"]
        if path == self._root or path.startswith(self._root + "/"):
            scope["path"] = path[len(self._root) :] or "/"
        scope["root_path"] = self._root

    def _find(self, kind: str, path: str) -> tuple[Asgi | None, frozenset[str]]:
        """Return the application of a path, and the parameters of its URL that may be secrets."""
        if self._seen != self._client_api.mounts:
            self._compile()
        if kind == "http" and path in self._own:
            return self._house, _NONE
        table = self._tables[kind]
        for prefix, suffix, app, secrets in table.get(_first(path)) or table[""]:
            if path.startswith(prefix) and path.endswith(suffix):
                rest = path[len(prefix) :]
                if not rest or rest[0] == "/" or prefix == "/":
                    return app, secrets
        return self._house if kind == "http" else None, _NONE

    def _compile(self) -> None:
        self._seen = list(self._client_api.mounts)
        order: Callable[[Mount], tuple[bool, int]] = lambda m: (bool(m.suffix), len(m.prefix))  # noqa: E731 - typed
        for kind in self._tables:
            here = (m for m in self._seen if m.kind == kind and m.port == self._port)
            mounts = sorted(here, key=order, reverse=True)
            served: list[_Served] = [(m.prefix, m.suffix, m.app, m.url_secrets) for m in mounts]
            if kind == "http" and self._port is None:
                served[:0] = self._absent_adapters()
            firsts = {_first(prefix) for prefix, *_ in served} | {""}
            self._tables[kind] = {
                first: [one for one in served if _first(one[0]) in ("", first)] for first in firsts
            }

    def _absent_adapters(self) -> list[_Served]:
        """Return what answers in the place of adapters that do not run."""
        prefixes = {mount.prefix for mount in self._seen}
        return [
            (f"/{name}", "", _absent(name, detail), _NONE)
            for name, detail in self._client_api.absent_adapters().items()
            if f"/{name}" not in prefixes
        ]


def _first(path: str) -> str:
    """Return the path to the end of its first segment; of `/`, nothing."""
    end = path.find("/", 1)
    return (path if end < 0 else path[:end]) if path != "/" else ""


def _absent(name: str, detail: str) -> Asgi:
    """Return the application that answers in the place of an adapter that does not run."""
    title = name.upper() if len(name) <= len("MCP") else name
    error = AdapterUnavailable(
        f"Command rejected \N{EM DASH} {title} adapter is not connected to the runtime.",
        remedy=f"On the gateway: {detail}.",
    )

    async def app(_scope: Scope, _receive: Receive, send: Send) -> None:
        await refuse(send, error)

    return app


async def _turn_away(
    scope: Scope, receive: Receive, send: Send, error: BadRequest | Forbidden | UnknownPath
) -> None:
    if scope["type"] == "http":
        await refuse(send, error)
        return
    await receive()  # websocket.connect

    async def denied(message: Any) -> None:
        await send({**message, "type": "websocket." + message["type"]})

    await refuse(denied, error)
