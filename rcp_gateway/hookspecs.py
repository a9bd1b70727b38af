"""The hooks. All are synchronous, run once before the event loop starts, and declare.

An async hook, an unknown hook name, or two records with one name stop the start-up with an error
that names the plugins. Nothing asynchronous and no message ever passes through a hook.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    from rcp_gateway.client_kinds import AdapterKind, TransportKind
    from rcp_kernel.features import FeatureKind
    from rcp_kernel.spi import BackendKind
    from rcp_profiles import Profile

__all__ = ["PROJECT", "hookimpl"]

PROJECT = "rcp"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def rcp_backends() -> Iterable[BackendKind]:  # pyright: ignore[reportReturnType]
    """Offer kinds of robots, used by `[[backends]] use = "<name>"`.

    Example::

        @hookimpl def rcp_backends():
            return [BackendKind("turtle", TurtleConfig, open_turtle)]
    """


@hookspec
def rcp_transports() -> Iterable[TransportKind]:  # pyright: ignore[reportReturnType]
    """Register transports, used by `[transports.<name>]`.

    Example::

        @hookimpl def rcp_transports():
            return [TransportKind("asgi", AsgiConfig, open_asgi)]
    """


@hookspec
def rcp_adapters() -> Iterable[AdapterKind]:  # pyright: ignore[reportReturnType]
    """Offer translations for one kind of client, used by `[plugins.<name>]`.

    Example::

        @hookimpl def rcp_adapters():
            return [AdapterKind("mcp", McpConfig, open_mcp)]
    """


@hookspec
def rcp_features() -> Iterable[FeatureKind]:  # pyright: ignore[reportReturnType]
    """Register features, used by `[features.<name>]`.

    Example::

        @hookimpl def rcp_features():
            return [FeatureKind("maintenance", MaintenanceConfig, make_maintenance)]
    """


@hookspec
def rcp_profiles() -> Iterable[Profile]:  # pyright: ignore[reportReturnType]
    """Publish profiles of a vendor's own, listed and exported by `rcpd profiles`.

    Example::

        @hookimpl def rcp_profiles():
            return [CRANE]
    """
