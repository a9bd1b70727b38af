"""The kinds of plugins that connect clients: transports and adapters."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Any

import msgspec

from rcp_gateway.client_api import ClientApi
from rcp_kernel.config.file import GatewayConfig

__all__ = ["AdapterKind", "TransportKind"]


class TransportKind(msgspec.Struct, frozen=True):
    """A transport, registered by the hook `rcp_transports`.

    `open(config, client_api)` is an async context manager: entered, it accepts clients; left, it
    has released them. It yields a mapping of facts for `/system/status` (its address).
    """

    name: str
    """Its table in the configuration: `[transports.<name>]`."""
    config: type[msgspec.Struct]
    open: Callable[[Any, ClientApi], AbstractAsyncContextManager[dict[str, Any]]]
    description: str = ""
    check: Callable[[Any, GatewayConfig], None] | None = None
    """Raises `ConfigError` if this table contradicts the rest of the configuration; also called by
    `rcpd check`, so it opens nothing."""
    listens: bool = False
    """Opened after all others, because it begins to accept clients."""
    needs: tuple[str, ...] = ()
    """As for `BackendKind`."""


class AdapterKind(msgspec.Struct, frozen=True):
    """A translation for one kind of client; offered by the hook `rcp_adapters`.

    Opened like a transport, before the transports are.
    """

    name: str
    """Its table in the configuration: `[plugins.<name>]`."""
    config: type[msgspec.Struct]
    open: Callable[[Any, ClientApi], AbstractAsyncContextManager[dict[str, Any]]]
    description: str = ""
    needs: tuple[str, ...] = ()
    """As for `BackendKind`."""
    wants: tuple[str, ...] = ()
    """As for `BackendKind`."""
    check: Callable[[Any, GatewayConfig], None] | None = None
    """As for `TransportKind`."""
    lacks: Callable[[Any], str | None] | None = None
    """As for `BackendKind`, but called once, at the start: the adapter stays `down`."""
