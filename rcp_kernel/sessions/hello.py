"""The body of `hello`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Hello"]


class Hello(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The body of `hello`."""

    token: Annotated[str, Meta(max_length=16_384)] | None = None
    session: Annotated[str, Meta(max_length=128)] | None = None
    resume_token: Annotated[str, Meta(max_length=128)] | None = None
    resume_from: int | dict[str, int] | None = None
    """The last `seq` the client has, of its one path or of each path."""
    client: Annotated[str, Meta(max_length=256)] | None = None
    tenant: Annotated[str, Meta(max_length=128)] | None = None
    """Which of the principal's tenants relative paths mean."""
    segment_size: Annotated[int, Meta(ge=1024, le=64 * 1024 * 1024)] | None = None
