"""What `[transports.ws]` may say."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["WsConfig"]


class WsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """WebSocket. Sizes in bytes, times in seconds; sizes of messages are the gateway's `[limits]`."""

    segment_size: Annotated[int, Meta(ge=1024)] = 1024 * 1024
    """Largest `segment_size` that a client may agree on for what it is sent."""
    transfers: Annotated[int, Meta(ge=1)] = 16
    """Segmented transfers of one connection that may be incomplete at once."""
    segments: Annotated[int, Meta(ge=1)] = 65_536
    """Segments of one transfer."""
    segment_timeout: Annotated[float, Meta(gt=0)] = 10.0
    """A transfer that gets nothing for so long is given up."""
    kept: Annotated[float, Meta(ge=0)] = 10.0
    """Time that a transfer sent can be asked for again."""
    backlog: Annotated[int, Meta(ge=1)] = 256
    """Replies that may wait for a client before nothing more is read from it."""
