"""JSON encoding of long values without a declared type, in steps of a few thousand values."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import msgspec

from rcp_protocol.plain import is_map, is_sequence

__all__ = ["is_long", "pieces"]

_PIECE = 4096  # values encoded per step
_PARTS = 16  # parts into which a long list is divided
_TEXT = 64  # characters or bytes that count as one value
_to_json = msgspec.json.Encoder()

Write = Callable[[Any], bytes]
"""Encodes a short value as JSON."""


def is_long(value: Any) -> bool:
    """Return whether encoding a value takes more than one step."""
    return _weight(value, _PIECE) > _PIECE


def pieces(value: Any, write: Write) -> Generator[None, None, bytes]:
    """Encode a value in steps; `write` encodes the short parts."""
    if isinstance(value, str):
        return _to_json.encode(value)  # it contains no number that needs special treatment
    if not is_long(value):
        return write(value)
    if is_sequence(value):
        return b"[%b]" % (yield from _items(value, write))
    if is_map(value):
        return b"{%b}" % (yield from _pairs(list(value.items()), write))
    return write(value)


def _items(values: Any, write: Write) -> Generator[None, None, bytes]:
    if not is_long(values):
        data = write(values)
        yield
        return data[1:-1]
    if len(values) == 1:
        return (yield from pieces(values[0], write))
    parts: list[bytes] = []
    for part in _divided(values):
        data = yield from _items(part, write)
        parts.append(data)
    return b",".join(parts)


def _pairs(items: list[tuple[str, Any]], write: Write) -> Generator[None, None, bytes]:
    values = dict(items)
    if not is_long(values):
        data = write(values)
        yield
        return data[1:-1]
    if len(items) == 1:
        key, value = items[0]
        head = write({key: None}).removesuffix(b"null}")[1:]
        return head + (yield from pieces(value, write))
    parts: list[bytes] = []
    for part in _divided(items):
        data = yield from _pairs(part, write)
        parts.append(data)
    return b",".join(parts)


def _divided(values: Any) -> Generator[Any]:
    size = min(_PIECE, -(-len(values) // _PARTS))
    for start in range(0, len(values), size):
        yield values[start : start + size]


def _weight(value: Any, most: int) -> int:
    """Count the values in `value`, but only up to slightly more than `most`."""
    if isinstance(value, (str, bytes)):
        return 1 + len(value) // _TEXT
    if is_map(value):
        found: Any = value.values()
    elif is_sequence(value):
        found = value
    else:
        return 1
    count = len(found)
    if count <= most:
        for one in found:
            count += _weight(one, most - count) - 1
            if count > most:
                break
    return count
