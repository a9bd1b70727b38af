"""Ranges of bytes (RFC 9110, section 14)."""

from __future__ import annotations

import re

from rcp_kernel.errors import BadRequest, RcpError
from rcp_web.asgi import Headers

__all__ = ["byte_range", "range_headers"]

_RANGE = re.compile(r"bytes=([0-9]{0,18})-([0-9]{0,18})\Z")
"""Of numbers as long as a size may be: longer ones are no range."""


class NotSatisfiable(BadRequest):
    """The range is outside the value."""

    http = 416


def byte_range(text: str, size: int) -> tuple[int, int] | None:
    """Return the part that a `Range` header names; None: the whole is a valid response too.

    :raises NotSatisfiable: it is outside.
    """
    match = _RANGE.match(text.strip())
    if match is None or match[0] == "bytes=-":
        return None  # several ranges or another unit
    if match[1]:
        start = int(match[1])
        stop = min(size, int(match[2]) + 1) if match[2] else size
    else:
        start, stop = max(0, size - int(match[2])), size
    if start >= stop:
        raise NotSatisfiable(f"the value has {size} bytes", details={"size": size})
    return start, stop


def range_headers(error: RcpError) -> Headers:
    """Return the header with the size, for a range outside the value."""
    if isinstance(error, NotSatisfiable) and error.details is not None:
        return [(b"content-range", b"bytes */%d" % error.details["size"])]
    return []
