"""The configuration of `[plugins.rosbridge]`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["Level", "RosbridgeConfig"]

Level = Literal["none", "error", "warning", "info"]


class RosbridgeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rosbridge protocol. Times in seconds."""

    path: Annotated[str, Meta(pattern=r"^/[A-Za-z0-9_./-]+$")] = "/rosbridge"
    """Path of the WebSocket."""
    port: Annotated[int, Meta(ge=0, le=65535)] | None = None
    """Port of its own, at `/`; rosbridge_suite has 9090. 0 takes a free one."""
    tenant: Annotated[str, Meta(min_length=1, max_length=128)] | None = None
    """Tenant of clients that name none; default: the first one of the client."""
    token_in_url: bool = False
    """Accept `?token=` in the URL, which may end up in logs."""
    valid_for: Annotated[float, Meta(gt=0, le=3600)] = 0.5
    """Time after which a robot stops unless the page publishes its velocity again."""
    lease: Annotated[float, Meta(gt=0, le=3600)] = 10.0
    """Duration of leases that are acquired for clients that publish where one is required."""
    queue: Annotated[int, Meta(ge=1, le=1024)] = 16
    """Messages kept for a slow client for each topic, where `queue_length` is 0."""
    write_interval: Annotated[float, Meta(ge=0, le=0.05)] = 0.005
    """Least time between two writes of a topic to its clients: messages that come faster share one, which
    is most of what a fast topic costs. Topics below 200 Hz are not delayed. 0: each is sent as it comes."""
    status: Level = "error"
    """Which status messages clients get until they send `set_level`."""
    fragment_timeout: Annotated[float, Meta(gt=0)] = 10.0
    """Time without a fragment after which a received message is dropped."""
