"""Converts the unpacked fields of a message to its value: one generated function per message."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

__all__ = ["Field", "making"]


class Field(NamedTuple):
    """One field of a message."""

    name: str
    kind: str
    """`uint16_t`, `float`, `char`, …"""
    unit: str
    factor: float
    length: int
    """Length of an array; 0 if it is not an array."""
    enum: dict[int, str] | None
    missing: float | None
    """The value that stands for "unknown"."""
    description: str
    place: int
    """Index of its first value in the unpacked tuple."""


def making(type_: Any, fields: Sequence[Field]) -> Callable[[tuple[Any, ...]], Any]:
    """Return the function that builds a value; generated, because it runs for every message."""
    known: dict[str, Any] = {"T": type_, "bytes": bytes, "str": str, "text": _text}
    parts = [_part(n, field, known) for n, field in enumerate(fields)]
    source = f"lambda v: T({', '.join(parts)})"
    known["__builtins__"] = {}
    return eval(source, known)  # noqa: S307 - generated from numbers and names only


def _part(n: int, field: Field, known: dict[str, Any]) -> str:
    """Return the expression of one field; constants that are not numbers go into `known`."""
    at, end = field.place, field.place + field.length
    if field.kind == "char":
        return f"text(v[{at}])"
    if field.length and field.kind == "uint8_t" and field.unit == "1":
        return f"bytes(v[{at}:{end}])"
    if field.length:
        one = _one(n, field, "x", known)
        return f"[{one} for x in v[{at}:{end}]]" if one != "x" else f"[*v[{at}:{end}]]"
    return _one(n, field, f"v[{at}]", known)


def _one(n: int, field: Field, x: str, known: dict[str, Any]) -> str:
    if field.enum is not None:
        known[f"w{n}"] = field.enum
        return f"w{n}[{x}] if {x} in w{n} else str({x})"
    value = x if field.factor == 1 else f"{x} {_scaled(field.factor)}"
    return value if field.missing is None else f"None if {x} == {field.missing!r} else {value}"


def _scaled(factor: float) -> str:
    """Return the scaling of a number; dividing by powers of ten keeps the decimals short."""
    whole = round(1 / factor)
    tens = whole > 1 and 1 / whole == factor and str(whole).rstrip("0") == "1"
    return f"/ {whole}.0" if tens else f"* {factor!r}"


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("utf-8", "replace")
