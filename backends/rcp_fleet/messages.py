"""The values that the hub itself has of each robot."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["GatewayLink", "LinkState"]

_Seconds = Annotated[float, Meta(extra_json_schema={"unit": "s"})]
_Bytes = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "By"})]
_Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]

LinkState = Literal["ready", "degraded", "down"]


class GatewayLink(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The gateway of a robot as the hub reaches it; what is not known is absent."""

    state: LinkState
    """`degraded`: the gateway answers, and says that its robot is not ready."""
    detail: str | None = None
    """Why it is not ready."""
    version: str | None = None
    """Version of the gateway."""
    protocol: str | None = None
    """Version of RCP that it speaks."""
    lacks: tuple[str, ...] = ()
    """What the gateway does not offer to this hub: because it is of an earlier version, or because
    of its configuration."""
    latency: _Seconds | None = None
    """The last round trip."""
    clock_offset: _Seconds | None = None
    """How far the robot's clock is ahead of the hub's."""
    clock_bound: _Seconds | None = None
    """The most by which `clock_offset` may be wrong."""
    sent: _Bytes
    """To the robot, since the hub first saw it, over all links: the hub's own and those of persons."""
    received: _Bytes
    links: _Count
    """Links begun."""
    lost: _Count
    """Links that ended because messages were lost on the way."""
    last_seen: str | None = None
    """When something was last received from it, by the hub's clock."""
    last_end: str | None = None
    """Why the last link that ended did."""
