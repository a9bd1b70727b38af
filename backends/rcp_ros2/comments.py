"""Comments on types and fields, from their `.msg`, `.srv` or `.action` text.

From Iron on, ROS includes the text in the compiled type support of every type; types defined at
run time provide their own.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

from rcp_ros2.idl import full_name

__all__ = ["Comments", "comments_of", "first_sentence", "remember", "text_of"]

_LONGEST = 400  # characters of one comment
_PARTS = {"Request": 0, "Response": 1, "Goal": 0, "Result": 1, "Feedback": 2}
"""The section of its parent's text that describes a class, by the end of the class name."""
_SOURCES = {"msg": 5, "srv": 10, "action": 7}
"""Offset of the function that returns the texts in each kind of type support."""
_FIELD = re.compile(r"\s*[A-Za-z][\w/]*(?:<=\d+)?(?:\[(?:<=)?\d*\])?\s+(\w+)\s*(=?)\s*([^#]*)")
_END = re.compile(r"(?<=[.!?])\s")
_texts: dict[str, str] = {}


class Comments(NamedTuple):
    """The comments on a type and on each of its fields."""

    whole: str = ""
    fields: dict[str, str] = {}  # noqa: RUF012 - never modified


class _String(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("room", ctypes.c_size_t))

    def text(self) -> str:
        raw = ctypes.string_at(self.data, self.size) if self.data else b""
        return raw.decode("utf-8", "replace")


class _Source(ctypes.Structure):
    """type_description_interfaces/msg/TypeSource."""

    _fields_ = (("name", _String), ("encoding", _String), ("contents", _String))


class _Sources(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.POINTER(_Source)),
        ("size", ctypes.c_size_t),
        ("room", ctypes.c_size_t),
    )


def remember(name: str, text: str) -> None:
    """Register the text of a type `pkg/msg/Name` without compiled code."""
    _texts[name] = text


@lru_cache(maxsize=4096)
def comments_of(cls: Any) -> Comments:
    """Return the comments on a message class, or on a part of a service or action."""
    return parsed(text_of(cls))


def text_of(cls: Any) -> str:
    """Return the text of a message class, or of a part of a service or action; empty if unknown."""
    parent, _, part = full_name(cls).rpartition("_")
    if part in _PARTS and parent.split("/")[1] != "msg":
        texts = re.split(r"^---.*$", _text(parent), flags=re.MULTILINE)
        return texts[_PARTS[part]] if len(texts) > _PARTS[part] else ""
    return _text(full_name(cls))


def _text(name: str) -> str:
    if name in _texts:
        return _texts[name]
    package, group, leaf = name.split("/")
    try:
        cls: Any = getattr(importlib.import_module(f"{package}.{group}"), leaf)
        return _compiled(cls, _SOURCES[group])
    except (ImportError, AttributeError, KeyError, ValueError):
        return ""


def _compiled(cls: Any, place: int) -> str:
    """Read the text from a class's type support; empty before Iron, which has none."""
    if importlib.util.find_spec("type_description_interfaces") is None:
        return ""
    kind = type(cls)
    if kind._TYPE_SUPPORT is None:  # noqa: SLF001 - the name rclpy uses
        kind.__import_type_support__()
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype = ctypes.c_void_p
    pointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
    support = pointer(kind._TYPE_SUPPORT, None)  # noqa: SLF001
    function = ctypes.cast(support, ctypes.POINTER(ctypes.c_void_p))[place]
    if not function:
        return ""
    get = ctypes.CFUNCTYPE(ctypes.POINTER(_Sources), ctypes.c_void_p)(function)
    found = get(support).contents
    return found.data[0].contents.text() if found.size else ""


def parsed(text: str) -> Comments:
    """Extract the comments: before and after each field, and above all fields."""
    whole: list[str] | None = None
    above: list[str] = []
    last: list[str] = []
    """The comment on the previous field."""
    fields: dict[str, list[str]] = {}
    values: list[tuple[str, str]] = []
    for line in text.splitlines():
        code, sign, comment = line.partition("#")
        words = comment.strip("#! \t")
        field = _FIELD.match(code)
        if field is not None:
            if whole is None:  # a comment directly above the first field describes the whole type
                whole, above = above, []
            last = []
            if field[2]:
                values.append((field[1], field[3].strip()))
            else:
                last = fields[field[1]] = [*above, words]
            above = []
        elif not sign:
            if whole is None and above:
                whole = above
            above, last = [], []
        elif last and line[:1].isspace():
            last.append(words)
        else:
            above.append(words)
    joined = {
        name: _joined([*comment, *_choices(name, values)]) for name, comment in fields.items()
    }
    return Comments(
        _joined(whole or []), {name: comment for name, comment in joined.items() if comment}
    )


def _choices(field: str, values: list[tuple[str, str]]) -> Iterator[str]:
    """List the constants whose names begin with the field's name."""
    start = field.upper() + "_"
    named = [
        f"{value} {name[len(start) :].lower()}" for name, value in values if name.startswith(start)
    ]
    if named:
        yield f"({', '.join(named)})"


def _joined(lines: list[str]) -> str:
    text = " ".join(line for line in lines if line.strip("-=* "))
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1].rsplit(" ", 1)[0] + "…"


def first_sentence(text: str) -> str:
    """Return the first sentence of a comment, without its full stop."""
    return _END.split(text, maxsplit=1)[0].rstrip(".") if text else ""
