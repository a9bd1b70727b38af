"""Foxglove WebSocket protocol: robots for Foxglove, Lichtblick and other viewers, at /foxglove."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_foxglove.config import FoxgloveConfig
from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.hookspecs import hookimpl

__all__ = ["FoxgloveConfig", "rcp_adapters"]


@hookimpl
def rcp_adapters() -> Iterable[AdapterKind]:
    """Provide the Foxglove WebSocket protocol."""
    from rcp_foxglove.endpoint import open_foxglove

    return [AdapterKind("foxglove", FoxgloveConfig, open_foxglove, __doc__ or "")]
