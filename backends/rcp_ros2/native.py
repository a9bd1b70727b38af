"""The serialised types of resources, for clients that speak CDR themselves.

A type's text is the `.msg` text of the message and of all messages in it, as rosbag2 and viewers
write them. The original text is used where it is known, because it has the constants.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

import msgspec

from rcp_kernel.model import NativeType
from rcp_ros2.cdr import Codec
from rcp_ros2.comments import text_of
from rcp_ros2.definitions import BadText, parse
from rcp_ros2.idl import Primitive, Ref, Sequence, Text, Type, fields_of, full_name
from rcp_ros2.writer import writer

__all__ = ["message_text", "native_type"]

_RULE = "=" * 80
_SPELLINGS = {"octet": "byte"}


@lru_cache(maxsize=4096)
def native_type(cls: Any, *, written: bool = False) -> NativeType:
    """Return the serialised type of a message class; `written` for a result that is encoded."""
    return NativeType(
        name=full_name(cls),
        encoding="cdr",
        schema_encoding="ros2msg",
        schema=message_text(cls),
        decode=None if written else Codec(cls).decode,
        encode=_encoder(cls) if written else None,
    )


def _encoder(cls: Any) -> Callable[[Any], bytes]:
    """Return what encodes a result, also as plain data: so it is in an error."""
    write, type_ = writer(cls), Codec(cls).type

    def encode(value: Any) -> bytes:
        return write(msgspec.convert(value, type_) if isinstance(value, dict) else value)

    return encode


def message_text(cls: Any) -> str:
    """Return the text of a message, then that of each message in it."""
    texts = [_text(cls)]
    for nested in _nested(cls, {cls}):
        package, _, leaf = full_name(nested).split("/")
        texts.append(f"{_RULE}\nMSG: {package}/{leaf}\n{_text(nested)}")
    return "\n".join(texts)


def _nested(cls: Any, known: set[Any]) -> Iterator[Any]:
    for field in fields_of(cls):
        inner = _class_of(field.type)
        if inner is not None and inner not in known:
            known.add(inner)
            yield inner
            yield from _nested(inner, known)


def _class_of(type_: Type) -> Any:
    if isinstance(type_, Sequence):
        return _class_of(type_.item)
    return type_.cls if isinstance(type_, Ref) else None


def _text(cls: Any) -> str:
    known = text_of(cls).strip("\0 \n")  # some compiled texts end with a NUL
    if known and _is_whole(cls, known):
        return known
    return "\n".join(f"{_spelled(f.type)} {f.name}" for f in fields_of(cls))


def _is_whole(cls: Any, text: str) -> bool:
    """Return whether a text has all fields: rosidl cuts those with characters that are not ASCII."""
    name = full_name(cls)
    try:
        parts = parse(name, text)[name]
    except BadText:
        return False
    return [part.name for part in parts] == [field.name for field in fields_of(cls)]


def _spelled(type_: Type) -> str:
    match type_:
        case Primitive(name):
            return _SPELLINGS.get(name, name)
        case Text(limit, wide):
            return ("wstring" if wide else "string") + (f"<={limit}" if limit else "")
        case Ref(cls):
            package, _, leaf = full_name(cls).split("/")
            return f"{package}/{leaf}"
        case Sequence(item, size, limit):
            return _spelled(item) + (
                f"[{size}]" if size is not None else f"[<={limit}]" if limit else "[]"
            )
