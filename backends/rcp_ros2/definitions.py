"""Message types made of their `.msg` text, for those that nobody can install.

Such a type can be listened to and not spoken: there is no code that would turn an object into its
bytes. What rclpy wants of it is in `support.py`.
"""

from __future__ import annotations

import re
from typing import Any

from rcp_kernel.errors import ConfigError
from rcp_ros2.idl import WIDTHS, Field, Primitive, Ref, Sequence, Text, Type, define, load
from rcp_ros2.support import forge

__all__ = ["TF_MESSAGE", "define_text", "is_made"]

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
_LINE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/\w+){0,2})(?:<=(?P<limit>\d+))?"
    r"(?:\[(?P<upto><=)?(?P<size>\d*)\](?P<array>))?\s+(?P<name>[A-Za-z]\w*)(?P<rest>.*)\Z"
)
_OLD = {"byte": "octet", "char": "uint8"}


def is_made(cls: Any) -> bool:
    """Tell whether a class was made of text."""
    return isinstance(cls, _Made)


def define_text(name: str, text: str) -> None:
    """Make the type `pkg/msg/Name`; an installed one goes before it.

    :raises ConfigError: a line of the text is none of a `.msg` file.
    """
    package, _, leaf = name.split("/")
    lines = [_parsed(name, package, line) for line in text.splitlines()]
    parts = [line for line in lines if line is not None]
    facts = {"__module__": f"{package}.msg", "parts": parts}
    kind = type(f"Metaclass_{leaf}", (_Made,), {})  # one for each type holds its support
    define(kind(leaf, (), facts))


class _Made(type):
    """The class of made classes: rclpy looks here for what makes a type usable."""

    parts: list[tuple[str, str, Any]]
    _TYPE_SUPPORT: Any = None
    _CREATE_ROS_MESSAGE = _CONVERT_FROM_PY = _CONVERT_TO_PY = _DESTROY_ROS_MESSAGE = ""

    def prepare(cls) -> None:
        """Get the type support that rclpy wants, once."""
        if cls._TYPE_SUPPORT is None:
            type(cls)._TYPE_SUPPORT = forge(cls, cls.described())  # noqa: SLF001 - its own

    def described(cls) -> tuple[Field, ...]:
        """Return the fields; the types they refer to are loaded only now."""
        return tuple(Field(name, shape(_base(base))) for name, base, shape in cls.parts)


def _base(text: str) -> Type:
    return Primitive(text) if text in WIDTHS else Ref(load(text))


def _parsed(type_name: str, package: str, line: str) -> tuple[str, str, Any] | None:
    """Return a field's name, its base type, and what makes its type of that; None if it has none."""
    code = line.partition("#")[0].strip()
    if not code:
        return None
    found = _LINE.match(code)
    if found is None:
        raise ConfigError(f"{line.strip()!r} in the text of {type_name} is no line of a .msg file")
    if found["rest"].strip().startswith("="):  # a constant
        return None
    size = int(found["size"]) if found["size"] else None
    many = found["array"] is not None

    def shape(base: Type) -> Type:
        if not many:
            return base
        return Sequence(base, None, size) if found["upto"] else Sequence(base, size, None)

    base = found["base"]
    if base in ("string", "wstring"):
        text = Text(int(found["limit"]) if found["limit"] else None, base == "wstring")
        return found["name"], "bool", lambda _base: shape(text)
    base = _OLD.get(base, base)
    if base not in WIDTHS and "/" not in base:
        base = f"{package}/msg/{base}"
    return found["name"], base, shape


define_text(TF_MESSAGE, "geometry_msgs/TransformStamped[] transforms")
