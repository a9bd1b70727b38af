"""A fleet: gateways of robots that dial in over Zenoh, as one tree."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_fleet.config import FleetConfig, check_hub
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind

__all__ = ["FleetConfig", "rcp_backends"]


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Offer the fleet."""
    from rcp_fleet.backend import open_fleet  # the engine is an extra

    needs = ("zenoh",)
    return [BackendKind("fleet", FleetConfig, open_fleet, __doc__ or "", needs, check_hub)]
