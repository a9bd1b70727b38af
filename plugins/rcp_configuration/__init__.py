"""Replaces the gateway's configuration file from afar, on probation until it is confirmed."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from rcp_configuration.service import (
    PATH,
    ConfigurationRequest,
    ConfigurationService,
    ConfigurationState,
)
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.role import HUB, Rule
from rcp_kernel.contract.events import Event
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.features.configuration import SERVED_CONFIGURATION
from rcp_kernel.model import Operation, Resource

__all__ = ["ConfigurationRequest", "ConfigurationState", "rcp_features"]

_RESOURCE = Resource(
    name="service/configuration",
    description="The gateway's configuration file: propose another one, and confirm it.",
    value=ConfigurationState,
    input=ConfigurationRequest,
    output=ConfigurationState,
    operations=Operation.READ | Operation.EXECUTE,
    examples=({"confirm": "0" * 64},),
    history=1,
)


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """It has no keys."""


def _make(_table: _Table, host: FeatureHost) -> Feature:
    service = ConfigurationService(host)

    def heard(event: Event) -> None:
        if event.what == "configuration":
            host.changed(PATH)

    return Feature(
        resources=(SystemResource(resource=_RESOURCE, view=service.view, execute=service.execute),),
        services={SERVED_CONFIGURATION: service.serve},
        on_event=heard,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `configuration`."""
    return [
        FeatureKind(
            "configuration",
            _Table,
            _make,
            __doc__ or "",
            needs=("cryptography",),
            grants={HUB: (Rule(("discover",), (PATH,)),)},
        )
    ]
