"""The listener: HTTP and WebSocket on one port, for everything that plugins mount."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_asgi.config import AsgiConfig
from rcp_gateway.client_kinds import TransportKind
from rcp_gateway.hookspecs import hookimpl

__all__ = ["AsgiConfig", "rcp_transports"]


@hookimpl
def rcp_transports() -> Iterable[TransportKind]:
    """Provide the listener."""
    from rcp_asgi.listener import open_asgi
    from rcp_asgi.safe import check_open

    return [
        TransportKind("asgi", AsgiConfig, open_asgi, __doc__ or "", check=check_open, listens=True)
    ]
