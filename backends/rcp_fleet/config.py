"""The options of `use = "fleet"`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["FleetConfig"]


class FleetConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A hub's side of the fleet. Times in seconds."""

    hub: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
    """The name of this hub, which no other one has."""
    listen: tuple[str, ...] = ()
    """Endpoints of the router in this process: `tcp/0.0.0.0:7447`; none: `connect` to one."""
    connect: tuple[str, ...] = ()
    """Endpoints of other routers."""
    token: str | None = None
    """What proves this hub to the gateways."""
    connect_timeout: Annotated[float, Meta(gt=0)] = 5.0
    """For a gateway's answer to `hello`."""
    silence: Annotated[float, Meta(ge=0.3)] = 3.0
    """After which a link counts as broken; also Zenoh's own lease."""
