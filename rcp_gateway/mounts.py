"""The parts of the HTTP tree that plugins serve through the listener."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any, Literal

import msgspec

from rcp_kernel.errors import PluginError
from rcp_kernel.sessions.session import Session

__all__ = ["Asgi", "Mount", "Mounts"]

Scope = MutableMapping[str, Any]
Asgi = Callable[
    [Scope, Callable[[], Awaitable[Any]], Callable[[Any], Awaitable[None]]], Awaitable[None]
]


class Mount(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the HTTP tree that a plugin serves through the listener of another one."""

    name: str
    """Who offers it, for logs and errors."""
    prefix: str
    """Path below which (and at which) requests go to `app`; the longest prefix wins."""
    suffix: str = ""
    """Only paths that end in it, ahead of every mount without one."""
    kind: Literal["http", "websocket"] = "http"
    app: Asgi
    """A plain ASGI application; `scope["path"]` is the whole path."""
    port: int | None = None
    """A port of its own, which serves nothing else; None: that of the listener. It must be mounted
    before the listener opens."""
    url_secrets: frozenset[str] = frozenset()
    """Parameters of the URL that may contain a secret, which is refused otherwise."""
    openapi: Callable[[Session], Awaitable[dict[str, Any]]] | None = None
    """Returns `paths` and `components` of the OpenAPI document for what a session sees of this
    mount; parts may be encoded already (`msgspec.Raw`). Long work waits for `turns`."""


class Mounts(list[Mount]):
    """All mounts, shared by the transports and adapters of a gateway."""

    def add(self, mount: Mount) -> None:
        """Add a mount.

        :raises PluginError: another plugin serves the same prefix, or has the same port.
        """
        for other in self:
            if _place(other) == _place(mount):
                raise PluginError(f"'{mount.name}' and '{other.name}' both serve {mount.prefix}")
            if mount.port and mount.port == other.port and mount.name != other.name:
                raise PluginError(f"'{mount.name}' and '{other.name}' both use port {mount.port}")
        self.append(mount)


def _place(mount: Mount) -> tuple[str, str, str, int | None]:
    return mount.kind, mount.prefix, mount.suffix, mount.port
