"""Times of the wire: ns since the epoch inside, ISO 8601 in UTC outside."""

from __future__ import annotations

import re
import time
from datetime import UTC, datetime

from rcp_kernel.errors import BadRequest

__all__ = ["iso", "now", "parse_time"]

_ISO = re.compile(
    r"(\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|z|[+-]\d\d:\d\d)\Z",
)

now = time.time_ns

_second = -1
_prefix = ""


def iso(ns: int) -> str:
    """Write ns since the epoch as ISO 8601 with microseconds, or nanoseconds if there are any."""
    global _second, _prefix  # noqa: PLW0603 - one cached second saves 1 µs on every message
    second, rest = divmod(ns, 1_000_000_000)
    if second != _second:
        _prefix = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(second))
        _second = second
    micro, nano = divmod(rest, 1000)
    return f"{_prefix}.{micro:06d}{nano:03d}Z" if nano else f"{_prefix}.{micro:06d}Z"


def parse_time(value: str | float) -> int:
    """Read the contract's `timestamp`: ISO 8601 UTC or epoch seconds; return ns since the epoch.

    :raises BadRequest: it is neither.
    """
    try:
        if not isinstance(value, str):
            return int(value * 1e9) if isinstance(value, float) else value * 1_000_000_000
        match = _ISO.match(value)
        if match is None:
            raise ValueError(value)
        zone = "+00:00" if match[3] in "Zz" else match[3]
        whole = datetime.fromisoformat(match[1].upper() + zone).astimezone(UTC)
        return int(whole.timestamp()) * 1_000_000_000 + int((match[2] or "0").ljust(9, "0"))
    except (ValueError, OverflowError):
        raise BadRequest(
            f"timestamp {str(value)[:40]!r} is not a time",
            remedy="Write ISO 8601 in UTC (2026-05-29T14:12:04Z) or seconds since the UNIX epoch.",
        ) from None
