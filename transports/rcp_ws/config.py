"""The configuration of `[transports.ws]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["WsConfig"]


class WsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """WebSocket. Sizes in bytes, times in seconds; the gateway's `[limits]` apply to messages."""

    segment_size: Annotated[int, Meta(ge=1024)] = 1024 * 1024
    """Maximum `segment_size` for messages to a client."""
    transfers: Annotated[int, Meta(ge=1)] = 16
    """Maximum number of incomplete segmented transfers per connection."""
    segments: Annotated[int, Meta(ge=1)] = 65_536
    """Maximum number of segments per transfer."""
    segment_timeout: Annotated[float, Meta(gt=0)] = 10.0
    """Time without a segment after which a received transfer is dropped."""
    kept: Annotated[float, Meta(ge=0)] = 10.0
    """Time for which segments of a sent transfer can be requested again."""
    backlog: Annotated[int, Meta(ge=1)] = 256
    """Maximum number of queued replies before reading from the client pauses."""
