"""Times on the wire: ns since the epoch internally, ISO 8601 in UTC externally."""

from __future__ import annotations

import re
import time
from datetime import UTC, datetime
from functools import lru_cache

import msgspec

from rcp_protocol.errors import BadRequest

__all__ = ["iso", "iso_bytes", "now", "parse_time"]

_ISO = re.compile(
    r"(\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|z|[+-]\d\d:\d\d)\Z",
)

now = time.time_ns
_LAST_SECOND = 253_402_300_799  # of the year 9999

_seconds: dict[int, str] = {}
_MAX_SECONDS = 256  # cached texts: messages in flight span only a few seconds
_SECOND = 1_000_000_000  # ns
_TWO = 2 * _SECOND
_WHOLE, _DOT = len("2026-05-29T14:12:04.250000000Z"), len("2026-05-29T14:12:04.")
_read: dict[str, int] = {}
"""Times of seconds read as `iso` writes them, ns."""
_last: tuple[int, str, bytes] = (1 << 80, "", b"")
"""The second before the last one formatted, in ns, and the last one's text."""
_decimal = msgspec.json.Encoder().encode


def iso(ns: int) -> str:
    """Format ns since the epoch as ISO 8601 in UTC with nanoseconds."""
    before, text, _ = _last
    # A billion more keeps the leading zeros, in half the time that `%09d` takes.
    digits = ns - before
    if not _SECOND <= digits < _TWO:
        text = _text_of(ns // _SECOND)
        digits = ns % _SECOND + _SECOND
    return f"{text}{str(digits)[1:]}Z"


def iso_bytes(ns: int) -> bytes:
    """Format as `iso` does, in ASCII."""
    before, _, text = _last
    digits = ns - before
    if not _SECOND <= digits < _TWO:
        text = _text_of(ns // _SECOND).encode()
        digits = ns % _SECOND + _SECOND
    return text + _decimal(int(digits))[1:] + b"Z"


def _text_of(second: int) -> str:
    global _last  # noqa: PLW0603 - a cache
    second = int(second)  # one of NumPy would make the next time, of somebody else, one of NumPy
    text = _seconds.get(second)
    if text is None:
        if len(_seconds) >= _MAX_SECONDS:
            _seconds.clear()
        text = _seconds[second] = time.strftime("%Y-%m-%dT%H:%M:%S.", time.gmtime(second))
    _last = (second - 1) * _SECOND, text, text.encode()
    return text


@lru_cache(maxsize=_MAX_SECONDS)
def _second_of(text: str, zone: str) -> int:
    """Return the seconds since the epoch; raises ValueError for a day or an hour that is none."""
    offset = "+00:00" if zone in "Zz" else zone
    return int(datetime.fromisoformat(text.upper() + offset).astimezone(UTC).timestamp())


def parse_time(value: str | float) -> int:
    """Parse a `timestamp`, ISO 8601 in UTC or epoch seconds; return ns since the epoch.

    :raises BadRequest: it is neither.
    """
    # As `iso` writes it, in a fifth of the time.
    if isinstance(value, str) and len(value) == _WHOLE:
        base, digits = _read.get(value[:_DOT]), value[_DOT:-1]
        if base is not None and digits.isdecimal() and value[-1] == "Z":
            return base + int(digits)
    try:
        if not isinstance(value, str):
            if abs(value) > _LAST_SECOND:
                raise ValueError(value)
            return int(value * 1e9) if isinstance(value, float) else value * 1_000_000_000
        match = _ISO.match(value)
        if match is None:
            raise ValueError(value)
        base = _second_of(match[1], match[3]) * _SECOND
        if len(value) == _WHOLE and value[-1] == "Z":
            if len(_read) >= _MAX_SECONDS:
                _read.clear()
            _read[value[:_DOT]] = base
        return base + int((match[2] or "0").ljust(9, "0"))
    except (ValueError, OverflowError):
        raise BadRequest(
            f"timestamp {str(value)[:40]!r} is not a timestamp",
            remedy="Use ISO 8601 in UTC (2026-05-29T14:12:04Z) or seconds since the UNIX epoch.",
        ) from None
