"""`rcp_protocol.values`, under the name that plugins import."""

from __future__ import annotations

from rcp_protocol.values import (
    ANY,
    DEPTH,
    Encoding,
    ValueType,
    dump,
    is_long,
    parse,
    sound,
    to_plain,
    value_type,
)

__all__ = [
    "ANY",
    "DEPTH",
    "Encoding",
    "ValueType",
    "dump",
    "is_long",
    "parse",
    "sound",
    "to_plain",
    "value_type",
]
