"""Values of any length in a few bytes: as JSON, or if they are long, their length and hash."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Generator
from typing import Any

import msgspec

from rcp_kernel.values import ANY, Encoding
from rcp_kernel.wire import Body

__all__ = ["LONGEST", "bounded", "hashed", "hashing"]

_encode = msgspec.json.Encoder().encode
_PIECE = 262_144  # bytes that are hashed in one step
LONGEST = 4096
"""Bytes of a value that are written out."""


def bounded(value: Any) -> Any:
    """Return a value as JSON, or its length and hash if it is long."""
    if isinstance(value, msgspec.Raw):  # it is JSON already
        return value
    if type(value) is float and math.isfinite(value):
        return msgspec.Raw(_encode(value))
    try:
        data = (
            value.encoded(Encoding.JSON)
            if isinstance(value, Body)
            else ANY.encode(value, Encoding.JSON)
        )
    except Exception:  # the rest of the record must be written regardless
        return {"unwritable": type(value).__name__}
    return msgspec.Raw(data) if len(data) <= LONGEST else hashed(data)


def hashed(data: bytes) -> dict[str, Any]:
    """Return the length and hash of data, in place of the data."""
    return {"length": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def hashing(data: bytes) -> Generator[None, None, dict[str, Any]]:
    """Compute `hashed` in steps."""
    digest, whole = hashlib.sha256(), memoryview(data)
    for start in range(0, len(data), _PIECE):
        digest.update(whole[start : start + _PIECE])
        yield
    return {"length": len(data), "sha256": digest.hexdigest()}
