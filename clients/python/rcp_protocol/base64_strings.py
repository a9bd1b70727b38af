"""Fast base64 for long bytes in JSON: pybase64 is sixty times faster than msgspec."""

from __future__ import annotations

from typing import Any, TypeGuard

import pybase64
from msgspec import Raw
from msgspec.structs import replace

__all__ = ["lifted"]

_LONG = 2048  # bytes from which it is faster


def lifted(value: Any, fields: tuple[str, ...]) -> Any:
    """Replace long bytes by base64: in these fields, or the value itself if none are given."""
    if not fields:
        return _in_base64(value) if _is_long(value) else value
    long: dict[str, Any] = {}
    for name in fields:
        blob = getattr(value, name, None)
        if _is_long(blob):
            long[name] = _in_base64(blob)
    return replace(value, **long) if long else value


def _is_long(value: Any) -> TypeGuard[bytes]:
    return isinstance(value, bytes) and len(value) > _LONG


def _in_base64(blob: bytes) -> Raw:
    # Join: formatting and adding may take twenty times as long.
    return Raw(b"".join((b'"', pybase64.b64encode(blob), b'"')))
