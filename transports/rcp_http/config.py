"""The configuration of `[transports.http]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["HttpConfig"]


class HttpConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """HTTP requests. Sizes in bytes, times in seconds; `[limits] message` limits bodies."""

    compress_above: Annotated[int, Meta(ge=0)] = 2048
    """Minimum size of responses to compress, for clients that accept zstd or gzip."""
    body_timeout: Annotated[float, Meta(gt=0)] = 30.0
    """Time-out for receiving the body of a request."""
    max_wait: Annotated[float, Meta(gt=0)] = 600.0
    """Maximum of `Prefer: wait`."""
