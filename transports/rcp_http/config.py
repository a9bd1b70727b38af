"""What `[transports.http]` may say."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["HttpConfig"]


class HttpConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Requests over HTTP. Sizes in bytes, times in seconds; the body's size is `[limits] message`."""

    compress_above: Annotated[int, Meta(ge=0)] = 2048
    """Longer answers are compressed for clients that accept zstd or gzip."""
    body_timeout: Annotated[float, Meta(gt=0)] = 30.0
    """For the whole of a request's body to come in."""
    max_wait: Annotated[float, Meta(gt=0)] = 600.0
    """Longest that `Prefer: wait` may hold an answer back."""
