"""The configuration of `[plugins.foxglove]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_gateway.api import check_pattern

__all__ = ["FoxgloveConfig", "check"]


class FoxgloveConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The Foxglove WebSocket protocol. Times in seconds."""

    path: Annotated[str, Meta(pattern=r"^/[A-Za-z0-9_./-]+$")] = "/foxglove"
    """Path of the WebSocket; `<path>/<tenant>` selects one of the caller's tenants."""
    port: Annotated[int, Meta(ge=0, le=65535)] | None = None
    """A port of its own, where the WebSocket is at `/` (and `/<tenant>`), as Foxglove expects it: 8765."""
    token_in_url: bool = False
    """Accept a key or token as `?token=`, which proxies and logs may record."""
    show: tuple[str, ...] = ("/**",)
    """Resources that are shown to clients, as far as their rights go."""
    ros_names: bool = True
    """Name what comes from ROS as ROS does (`/odom`), and everything else by its path."""
    depth: Annotated[int, Meta(ge=1, le=1024)] = 16
    """Messages queued for each subscription of a slow client; older ones are skipped."""
    write_interval: Annotated[float, Meta(ge=0, le=0.05)] = 0.005
    """Least time between two writes of a topic to its clients: messages that come faster share one, which
    is most of what a fast topic costs. Topics below 200 Hz are not delayed. 0: each is sent as it comes."""
    valid_for: Annotated[float, Meta(gt=0, le=3600)] | None = None
    """Validity of what a client publishes to an actuator with a dead-man; default: the actuator's own."""
    lease: Annotated[float, Meta(gt=0, le=3600)] = 10.0
    """Duration of leases acquired for clients that publish where one is required."""
    call_timeout: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    """Maximum duration of a service call; default: that of the service."""
    time: Annotated[float, Meta(ge=0, le=100)] = 0.0
    """Rate in Hz at which the gateway's time is sent; 0: it is not."""


def check(config: FoxgloveConfig) -> None:
    """Refuse invalid patterns.

    :raises ConfigError: names the key.
    """
    for pattern in config.show:
        check_pattern(pattern, "[plugins.foxglove] show")
