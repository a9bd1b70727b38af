"""What a type accepts, in plain words."""

from __future__ import annotations

import enum
import re
import types
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

import msgspec
from msgspec import Meta

__all__ = ["choices", "expected", "split_annotated"]

_SCALARS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    bytes: "a text in base64",
    dict: "a table",
    list: "a list",
    tuple: "a list",
}
_SETS = {"A-Z": "capital letters", "a-z": "small letters", "0-9": "digits"}
_SIMPLE = re.compile(r"\^\[((?:[^\]\\]|\\.)+)\](?:\+|\{(\d+)(?:,(\d+))?\})\$?\Z")


_PREFIX = re.compile(r"\^([\w/]+)\Z")


def split_annotated(type_: Any) -> tuple[Any, list[Meta]]:
    """Return a type without its annotations, and those that msgspec reads."""
    metas: list[Meta] = []
    while get_origin(type_) is Annotated:
        type_, *found = get_args(type_)
        metas += [one for one in found if isinstance(one, Meta)]
    return type_, metas


def members(type_: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the type alone."""
    return get_args(type_) if get_origin(type_) in (Union, types.UnionType) else (type_,)


def choices(type_: Any) -> list[str]:
    """Return the values of an enumeration; of a union those of all its members."""
    type_, _ = split_annotated(type_)
    if get_origin(type_) is Literal:
        return [str(value) for value in get_args(type_)]
    if isinstance(type_, type) and issubclass(type_, enum.Enum):
        return [str(one.value) for one in type_]
    several = members(type_)
    return [] if len(several) == 1 else [word for one in several for word in choices(one)]


def expected(type_: Any) -> str:
    """Return what a type accepts: "a whole number, at least 1"."""
    type_, metas = split_annotated(type_)
    several = [one for one in members(type_) if one is not type(None)]
    if len(several) > 1:
        return " or ".join(dict.fromkeys(expected(one) for one in several))
    if len(several) == 1 and several[0] is not type_:
        return ", ".join([expected(several[0]), *_bounds(metas)])
    found = choices(type_)
    if found:
        return "one of " + ", ".join(f'"{one}"' if get_origin(type_) else one for one in found)
    if isinstance(type_, type) and issubclass(type_, msgspec.Struct):
        return "a table"
    origin = cast("Any", get_origin(type_) or type_)
    base = _SCALARS.get(origin) or (
        "a table" if isinstance(origin, type) and issubclass(origin, Mapping) else "another value"
    )
    return ", ".join([base, *_bounds(metas)])


def _bounds(metas: Iterable[Meta]) -> list[str]:
    found: list[str] = []
    for meta in metas:
        if meta.description:
            found.append(meta.description)
        elif meta.pattern:
            found.append(_of_pattern(meta.pattern))
        bounds = (
            (meta.ge, "at least {}"),
            (meta.gt, "greater than {}"),
            (meta.le, "at most {}"),
            (meta.lt, "less than {}"),
            (meta.multiple_of, "a multiple of {}"),
        )
        found += [text.format(_number(at)) for at, text in bounds if at is not None]
        found += _lengths(meta)
    return found


def _number(value: float) -> str:
    return str(value).removesuffix(".0")


def _lengths(meta: Meta) -> list[str]:
    found: list[str] = []
    if meta.min_length:
        found.append(f"at least {meta.min_length} long" if meta.min_length > 1 else "not empty")
    if meta.max_length is not None:
        found.append(f"at most {meta.max_length} long")
    return found


def _of_pattern(pattern: str) -> str:
    """Return what a pattern of one set of characters accepts; of another, that it has a form."""
    simple = _SIMPLE.match(pattern)
    if simple is None and (begins := _PREFIX.match(pattern)) is not None:
        return f"beginning with '{begins[1]}'"
    if simple is None:
        return "in the form that the documentation gives"
    letters, least, most = simple.groups()
    found: list[str] = []
    rest = re.sub(r"A-Za-z", lambda _: found.append("letters") or "", letters)
    for given, word in _SETS.items():
        if given in rest:
            found.append(word)
            rest = rest.replace(given, "")
    ranges = re.findall(r"\w-\w", rest)
    rest = re.sub(r"\w-\w", "", rest).replace("\\", "")
    found += [f"{one[0]} to {one[2]}" for one in ranges]
    found += [f"`{one}`" for one in dict.fromkeys(rest)]
    text = "of " + ", ".join(found)
    if least and most is None:
        return f"{least} characters {text}"
    return f"{text}; at most {most} characters" if most else text
