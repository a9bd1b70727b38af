"""msgspec types of ROS messages, created at run time: outputs and inputs.

In an output, every field is present and every float may be NaN or infinite, as sensors report it.
In an input, omitted fields have ROS's defaults, and floats are finite unless a mapping allows others.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from rcp_kernel.errors import ConfigError
from rcp_kernel.types import NONFINITE
from rcp_ros2.comments import comments_of
from rcp_ros2.idl import Primitive, Ref, Sequence, Text, Type, fields_of, full_name, is_defined
from rcp_ros2.units import unit_of

__all__ = [
    "bare",
    "example_of",
    "framed",
    "inward",
    "is_bytes",
    "kinds_of",
    "outward",
    "part_of",
]

_FLOAT32 = 3.4028234663852886e38
_INTS: dict[str, tuple[int, int | None]] = {
    "octet": (0, 2**8 - 1),
    "int8": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, None),  # msgspec's bounds end with int64; `values.py` checks the upper one
}
_made: dict[tuple[Any, bool, str | None, bool], type[Struct]] = {}


def outward(cls: Any, path: str | None = None, unit: str | None = None) -> Any:
    """Return the output type of a message class, or of the field at `path`.

    `unit` applies to numbers without a known unit.

    :raises ConfigError: the message has no such field.
    """
    if path is None:
        return _struct(cls, out=True, unit=unit, free=True)
    holder, field, inherited = part_of(cls, path)
    own = unit_of(full_name(holder), path.rpartition(".")[2])
    return _typed(field, out=True, unit=own or inherited or unit, free=True)


def inward(cls: Any, unit: str | None = None, *, nan: bool = False) -> type[Struct]:
    """Return the input type of a message class; with `nan`, its floats may be NaN or infinite."""
    return _struct(cls, out=False, unit=unit, free=nan)


def part_of(cls: Any, path: str) -> tuple[Any, Type, str | None]:
    """Find the field at `pose.pose`: its class, its type, and an inherited unit.

    :raises ConfigError: the message has no such field.
    """
    unit: str | None = None
    names = path.split(".")
    for depth, name in enumerate(names):
        found = next((f.type for f in fields_of(cls) if f.name == name), None)
        if found is None:
            raise ConfigError(
                f"{full_name(cls)} has no field '{name}' (of '{path}'); it has "
                + ", ".join(f.name for f in fields_of(cls))
            )
        if depth == len(names) - 1:
            return cls, found, unit
        if not isinstance(found, Ref):
            raise ConfigError(f"'{name}' of {full_name(cls)} has no fields (in '{path}')")
        unit = unit_of(full_name(cls), name) or unit
        cls = found.cls
    raise AssertionError(path)


def bare(type_: Any) -> Any:
    """Return a type without its annotations."""
    return type_.__origin__ if hasattr(type_, "__metadata__") else type_


def kinds_of(type_: Any) -> dict[str, Any]:
    """Return the types of a struct's fields, without annotations."""
    return {name: bare(kind) for name, kind in bare(type_).__annotations__.items()}


def framed(type_: Any, frame: str | None) -> Any:
    """Return a type whose schema contains the frame of its values."""
    if frame is None:
        return type_
    return Annotated[type_, Meta(extra_json_schema={"frame_id": frame})]


def is_bytes(item: Type) -> bool:
    """Return whether a sequence of `item` is a byte string."""
    return isinstance(item, Primitive) and item.name in ("uint8", "octet")


def example_of(type_: type[Struct]) -> tuple[Any, ...]:
    """Return an example of an input: its defaults, as plain data."""
    try:
        plain = msgspec.to_builtins(type_())
        msgspec.convert(plain, type_)
    except (msgspec.MsgspecError, TypeError, ValueError):
        return ()
    return (plain,) if plain else ()


def _struct(cls: Any, *, out: bool, unit: str | None, free: bool) -> type[Struct]:
    key = (cls, out, unit, free)
    if key in _made:
        return _made[key]
    name = full_name(cls)
    comments = comments_of(cls)
    sample = None if out or is_defined(cls) else cls()
    fields: list[Any] = []
    for field in fields_of(cls):
        typed = _typed(field.type, out=out, unit=unit_of(name, field.name) or unit, free=free)
        text = comments.fields.get(field.name)
        shown = typed if text is None else Annotated[typed, Meta(description=text)]
        if out:
            fields.append((field.name, shown))
        else:
            value = _zero(field.type) if sample is None else getattr(sample, field.name)
            fields.append((field.name, shown, _default(field.type, typed, value)))
    # Two units of one message in one schema need two names: Vector3_m_s and Vector3_rad_s.
    suffix = "" if unit is None else "_" + unit.replace("/", "_").replace(".", "_")
    suffix += "" if out or not free else "_nan"
    made = msgspec.defstruct(
        cls.__name__ + suffix,
        fields,
        module=".".join(name.split("/")[:2]),
        namespace={"__doc__": comments.whole or None},
        frozen=True,
        gc=False,
        forbid_unknown_fields=True,
    )
    _made[key] = made
    return made


def _typed(type_: Type, *, out: bool, unit: str | None, free: bool) -> Any:
    match type_:
        case Primitive(name):
            return _number(name, unit=unit, free=free)
        case Text(limit, _):
            return str if limit is None else Annotated[str, Meta(max_length=limit)]
        case Ref(cls):
            return _struct(cls, out=out, unit=unit, free=free)
        case Sequence(item, size, limit):
            inner: Any = (
                bytes if is_bytes(item) else list[_typed(item, out=out, unit=unit, free=free)]
            )
            if size is not None:
                return Annotated[inner, Meta(min_length=size, max_length=size)]
            return inner if limit is None else Annotated[inner, Meta(max_length=limit)]


def _number(name: str, *, unit: str | None, free: bool) -> Any:
    extra: Any = {} if unit is None else {"unit": unit}
    if name == "bool":
        return bool
    if name in ("float32", "float64"):
        if free:
            return Annotated[float, Meta(extra_json_schema={**extra, NONFINITE: True})]
        if name == "float32":
            return Annotated[float, Meta(ge=-_FLOAT32, le=_FLOAT32, extra_json_schema=extra)]
        return Annotated[float, Meta(extra_json_schema=extra)]
    low, high = _INTS[name]
    if high is None:
        return Annotated[int, Meta(ge=low, extra_json_schema={**extra, "maximum": 2**64 - 1})]
    return Annotated[int, Meta(ge=low, le=high, extra_json_schema=extra)]


def _zero(type_: Type) -> Any:
    """Return the default of a field of a type without compiled code."""
    match type_:
        case Primitive("octet"):
            return b"\0"
        case Primitive("bool"):
            return False
        case Primitive("float32" | "float64"):
            return 0.0
        case Primitive():
            return 0
        case Text():
            return ""
        case Ref():
            return None
        case Sequence(item, size, _):
            return [_zero(item)] * (size or 0)


def _default(type_: Type, typed: Any, value: Any) -> Any:
    match type_:
        case Primitive("octet"):
            return value[0]
        case Primitive():
            return value if not isinstance(value, float) or math.isfinite(value) else 0.0
        case Text():
            return value
        case Ref():
            return typed()
        case Sequence(item, size, _):
            plain = _plain(item, typed, value)
            if not size and not plain:
                return b"" if is_bytes(item) else []
            return plain if is_bytes(item) else msgspec.field(default_factory=lambda: list(plain))


def _plain(item: Type, typed: Any, value: Any) -> Any:
    if is_bytes(item):
        return b"".join(value) if item == Primitive("octet") else bytes(value)
    if isinstance(item, Ref):
        return [bare(typed).__args__[0]() for _ in value]
    return value.tolist() if hasattr(value, "tolist") else list(value)
