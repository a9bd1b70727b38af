"""What older clients send: stamps of ROS 1, and bytes as lists of numbers."""

from __future__ import annotations

import base64
from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest

__all__ = ["decoded", "has_bytes", "modern"]

_DEPTH = 8  # nested messages that are searched for bytes
_OLD_STAMPS = (b'"secs"', b'"nsecs"')
_OLD_TIME = {"secs": "sec", "nsecs": "nanosec"}


def modern(body: msgspec.Raw, schema: dict[str, Any], *, has_bytes: bool) -> msgspec.Raw:
    """Return a message as ROS 2 has it; `schema` is that of the value, which may have bytes.

    A message that needs no change is not decoded.

    :raises BadRequest: the message cannot be decoded.
    """
    data = bytes(body)
    old = any(name in data for name in _OLD_STAMPS)
    if not old and not has_bytes:
        return body
    value = decoded(body)
    try:
        if old:
            value = _renamed(value)
        return msgspec.Raw(msgspec.json.encode(_with_bytes(value, schema, schema)))
    except RecursionError:
        raise BadRequest("the message is nested too deep") from None


def decoded(body: msgspec.Raw) -> Any:
    """Decode a part of a message.

    :raises BadRequest: it is malformed.
    """
    try:
        return msgspec.json.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadRequest(f"the message is not JSON: {error}") from None


def _renamed(value: Any) -> Any:
    if isinstance(value, list):
        return [_renamed(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    if not isinstance(value, dict):
        return value
    names: set[Any] = set(value)  # pyright: ignore[reportUnknownArgumentType]
    if names and names <= _OLD_TIME.keys():
        return {_OLD_TIME[name]: item for name, item in value.items()}  # pyright: ignore[reportUnknownVariableType,reportUnknownArgumentType]
    old_header = "stamp" in names and "frame_id" in names
    return {
        name: _renamed(item)
        for name, item in value.items()  # pyright: ignore[reportUnknownVariableType]
        if not (old_header and name == "seq")
    }


def _resolved(schema: Any, whole: dict[str, Any]) -> dict[str, Any]:
    if isinstance(schema, dict) and isinstance(ref := schema.get("$ref"), str):  # pyright: ignore[reportUnknownMemberType,reportUnknownVariableType]
        schema = whole.get("$defs", {}).get(ref.rpartition("/")[2])
    return schema if isinstance(schema, dict) else {}  # pyright: ignore[reportUnknownVariableType]


def has_bytes(schema: dict[str, Any]) -> bool:
    """Return whether a value of a schema has bytes somewhere."""
    return _has_bytes(schema, schema, _DEPTH)


def _has_bytes(schema: Any, whole: dict[str, Any], depth: int) -> bool:
    found = _resolved(schema, whole)
    if "contentEncoding" in found:
        return True
    if not depth:
        return False
    inner = [*found.get("properties", {}).values()]
    if "items" in found:
        inner.append(found["items"])
    return any(_has_bytes(one, whole, depth - 1) for one in inner)


def _with_bytes(value: Any, schema: Any, whole: dict[str, Any]) -> Any:
    found = _resolved(schema, whole)
    if "contentEncoding" in found:
        if isinstance(value, list):
            try:
                return base64.b64encode(bytes(value)).decode()  # pyright: ignore[reportUnknownArgumentType]
            except (TypeError, ValueError):
                return value  # pyright: ignore[reportUnknownVariableType]
        return value
    if isinstance(value, dict):
        fields = found.get("properties", {})
        return {
            name: _with_bytes(item, fields.get(name), whole)  # pyright: ignore[reportUnknownArgumentType]
            for name, item in value.items()  # pyright: ignore[reportUnknownVariableType]
        }
    if isinstance(value, list) and "items" in found:
        return [_with_bytes(item, found["items"], whole) for item in value]  # pyright: ignore[reportUnknownVariableType]
    return value  # pyright: ignore[reportUnknownVariableType]
