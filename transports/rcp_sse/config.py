"""The configuration of `[transports.sse]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["SseConfig"]


class SseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Server-sent events. Times in seconds."""

    comment: Annotated[float, Meta(gt=0)] = 15.0
    """Interval of the comments that keep proxies from closing the connection."""
    journal: Annotated[int, Meta(ge=16)] = 1024
    """Events per stream that are kept for clients that resume."""
