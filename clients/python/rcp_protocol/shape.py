"""The positions in a type of numbers that JSON cannot represent exactly.

msgspec validates; what it does not cover is compiled here into a tree parallel to the type: floats
that may be non-finite, integers beyond 2^53, and field names. The tree is walked only for values
that contain such numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import inspect as mi

from rcp_protocol.plain import is_index, is_map, is_sequence
from rcp_protocol.types import NONFINITE

__all__ = ["SAFE_INTEGER", "Beyond", "Node", "Shape", "children", "facts_of", "unescaped"]

SAFE_INTEGER = 2**53 - 1
_REALS = frozenset((int, float))
_NEVER_ODD = frozenset((str, bool, type(None), bytes))
_USUAL = _REALS | _NEVER_ODD
_NAMES = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}

Node = Callable[[Any, str], Any]
"""Converts a builtin value at a JSON Pointer; raises `ValueError(pointer, why)` if it is
invalid."""


Quick = Callable[[set[type], Any], bool]
"""Returns whether no number in a list needs conversion, by the set of element types first."""


class Beyond(ValueError):
    """An integer exceeds the bits of its type: `(pointer, why, bound)`."""


class Shape:
    """msgspec's type information about the numbers and fields of one type."""

    def __init__(self, type_: Any) -> None:
        self._out: dict[type, Node] = {}
        self._in: dict[type, Node] = {}
        self._quick: dict[Node, Quick] = {}
        self._fields: dict[type, dict[str, mi.Type]] = {}
        self.has_float = False
        self.has_wide_int = False
        self.grows = False
        self.open = False
        """Whether some part may be of any type."""
        self.endless = False
        """Whether the type is recursive."""
        self._within: list[type] = []
        self._info = mi.type_info(type_)
        self.blobs = _blobs(self._info)
        """The struct fields that contain bytes, an empty tuple for bytes themselves; None: no
        bytes."""
        self.outward = self._node(self._info, self._out, outward=True)
        self.inward = self._node(self._info, self._in, outward=False)

    def has_field(self, dotted: str) -> bool:
        """Return whether `position.x` is a part of the type."""
        found = [self._info]
        for name in dotted.split("."):
            found = [child for info in found for child in children(info, name)]
        return bool(found)

    def unit(self, pointer: str) -> str | None:
        """Return the unit of the number at a JSON Pointer, if its type names one."""
        found, unit = [self._info], None
        for name in [unescaped(p) for p in pointer.split("/") if p]:
            found = [child for info in found for child in children(info, name)]
        for info in found:
            unit = facts_of(info).get("unit", unit)
        return unit

    def _node(self, info: mi.Type, memo: dict[type, Node], *, outward: bool) -> Node:
        extra: dict[str, Any] = {}
        while isinstance(info, mi.Metadata):
            extra |= facts_of(info)
            info = info.type
        match info:
            case mi.FloatType():
                self.has_float = True
                free = bool(extra.get(NONFINITE))
                return self._noted(_float_node(free=free, outward=outward))
            case mi.IntType():
                return self._int_node(info, extra, outward=outward)
            case mi.BytesType() | mi.ByteArrayType() | mi.MemoryViewType():
                self.grows = True
                return _same
            case mi.ListType() | mi.VarTupleType() | mi.SetType() | mi.FrozenSetType():
                self.grows = True
                if outward and _is_free_float(info.item_type):
                    self.has_float = True
                    return _float_list_node
                item = self._node(info.item_type, memo, outward=outward)
                if item is _whole:
                    return _whole_list_node
                return _list_node(item, self._quick.get(item))
            case mi.TupleType():
                return _tuple_node([self._node(t, memo, outward=outward) for t in info.item_types])
            case mi.NamedTupleType():
                return _tuple_node([self._node(f.type, memo, outward=outward) for f in info.fields])
            case mi.DictType():
                self.grows = True
                return _dict_node(self._node(info.value_type, memo, outward=outward))
            case mi.StructType() | mi.TypedDictType() | mi.DataclassType():
                return self._struct_node(info, memo, outward=outward)
            case mi.UnionType():
                return self._union_node(info, memo, outward=outward)
            case mi.AnyType():
                self.has_float = self.has_wide_int = self.grows = self.open = True
                return _any_node if outward else _same
            case _:
                return _same

    def _int_node(self, info: mi.IntType, extra: dict[str, Any], *, outward: bool) -> Node:
        low = info.ge if info.ge is not None else info.gt
        high = info.le if info.le is not None else info.lt
        if low is not None and high is not None and low >= -SAFE_INTEGER and high <= SAFE_INTEGER:
            return _same if outward else _whole
        self.has_wide_int = True
        if not outward:  # msgspec checks its declared bounds, with a better message
            top = extra.get("maximum", 2**63 - 1)
            return self._noted(_int_node(-(2**63), top, outward=False))
        top = extra.get("maximum", high if high is not None else 2**63 - 1)
        bottom = extra.get("minimum", low if low is not None else -(2**63))
        return self._noted(_int_node(bottom, top, outward=True))

    def _noted(self, made: tuple[Node, Quick]) -> Node:
        node, quick = made
        self._quick[node] = quick
        return node

    def _struct_node(self, info: Any, memo: dict[type, Node], *, outward: bool) -> Node:
        fields: dict[str, Node] = {}
        if (known := memo.get(info.cls)) is not None:
            self.endless = self.endless or info.cls in self._within
            return known
        node = _struct_node(fields)
        memo[info.cls] = node
        self._within.append(info.cls)
        for field in info.fields:
            child = self._node(field.type, memo, outward=outward)
            if child is not _same:
                fields[field.encode_name] = child
        self._within.pop()
        return node

    def _union_node(self, info: mi.UnionType, memo: dict[type, Node], *, outward: bool) -> Node:
        nodes = [(option, self._node(option, memo, outward=outward)) for option in info.types]
        # If a number may be of either type, the checks of both must apply.
        number = _chain([node for option, node in nodes if _is_number(option)])
        others = [node for option, node in nodes if not _is_number(option)]
        live = [node for node in (number, *others) if node is not _same]
        if not live:
            return _same
        node = live[0] if len(live) == 1 else _first_of(live)
        if not outward and any(isinstance(_bare(option), mi.StrType) for option in info.types):
            return _unless_text(node)
        return node


def children(info: mi.Type, name: str) -> list[mi.Type]:
    """Return the possible types of a named field, or of the element at an index."""
    match info:
        case mi.Metadata():
            return children(info.type, name)
        case mi.StructType() | mi.TypedDictType() | mi.DataclassType() | mi.NamedTupleType():
            return [f.type for f in info.fields if f.encode_name == name]
        case mi.DictType():
            return [info.value_type]
        case mi.UnionType():
            return [c for option in info.types for c in children(option, name)]
        case mi.ListType() | mi.VarTupleType():
            return [info.item_type] if is_index(name) else []
        case mi.TupleType():
            inside = is_index(name) and int(name) < len(info.item_types)
            return [info.item_types[int(name)]] if inside else []
        case mi.AnyType():
            return [info]
        case _:
            return []


def _blobs(info: mi.Type) -> tuple[str, ...] | None:
    info = _bare(info)
    if isinstance(info, mi.BytesType):
        return ()
    if not isinstance(info, mi.StructType):
        return None
    return tuple(f.name for f in info.fields if isinstance(_bare(f.type), mi.BytesType)) or None


def _is_free_float(info: mi.Type) -> bool:
    """Return whether a type is just a float that may be NaN or infinite."""
    free = isinstance(info, mi.Metadata) and bool(facts_of(info).get(NONFINITE))
    return free and isinstance(_bare(info), mi.FloatType)


def _bare(info: mi.Type) -> mi.Type:
    while isinstance(info, mi.Metadata):
        info = info.type
    return info


def _is_number(info: mi.Type) -> bool:
    return isinstance(_bare(info), (mi.IntType, mi.FloatType))


def _unless_text(node: Node) -> Node:
    """Leave strings alone where the type allows them: there, `"123"` is not a number."""

    def checked(value: Any, pointer: str) -> Any:
        return value if isinstance(value, str) else node(value, pointer)

    return checked


def _escaped(key: Any) -> str:
    return str(key).replace("~", "~0").replace("/", "~1")


def unescaped(step: str) -> str:
    """Return the key of a JSON Pointer segment."""
    return step.replace("~1", "/").replace("~0", "~")


def facts_of(info: mi.Type) -> dict[str, Any]:
    """Return the additional facts of a type, such as its unit."""
    return getattr(info, "extra_json_schema", None) or {}


def _are_finite(numbers: Any) -> bool:
    try:
        return all(map(math.isfinite, numbers))
    except OverflowError:  # an integer beyond the range of floats
        return False


def _are_usual(kinds: set[type], value: Any) -> bool:
    """Return whether JSON represents all elements of a list exactly."""
    if _NEVER_ODD.issuperset(kinds):
        return True
    if not _USUAL.issuperset(kinds):
        return False
    numbers = value if _REALS.issuperset(kinds) else [v for v in value if type(v) in _REALS]
    return _are_finite(numbers) and min(numbers) >= -SAFE_INTEGER and max(numbers) <= SAFE_INTEGER


def _spelled(value: float) -> str:
    return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")


def _same(value: Any, _pointer: str) -> Any:
    return value


def _float_node(*, free: bool, outward: bool) -> tuple[Node, Quick]:
    def out(value: Any, pointer: str) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            if not free:
                raise ValueError(pointer, "is not a finite number")
            return _spelled(value)
        return value

    def into(value: Any, pointer: str) -> Any:
        if isinstance(value, str) and value in _NAMES:
            value = _NAMES[value]
        if isinstance(value, float) and not free and not math.isfinite(value):
            raise ValueError(pointer, "is not a finite number")
        return value

    def quick(kinds: set[type], value: Any) -> bool:
        return _REALS.issuperset(kinds) and _are_finite(value)

    return (out if outward else into), quick


def _float_list_node(value: Any, _pointer: str) -> Any:
    """Convert a list of readings in one call: laser scans are too long for a call per element."""
    if is_sequence(value):
        return [_spelled(v) if isinstance(v, float) and not math.isfinite(v) else v for v in value]
    return value


def _int_node(bottom: int, top: int, *, outward: bool) -> tuple[Node, Quick]:
    def checked(value: int, pointer: str) -> int:
        if not bottom <= value <= top:
            bound = f"<= {top}" if value > top else f">= {bottom}"
            raise Beyond(pointer, f"lies outside {bottom}…{top}", bound)
        return value

    def out(value: Any, pointer: str) -> Any:
        if isinstance(value, int) and not isinstance(value, bool):
            checked(value, pointer)
            return str(value) if abs(value) > SAFE_INTEGER else value
        return value

    def into(value: Any, pointer: str) -> Any:
        if isinstance(value, str) and len(value) <= 21 and value.lstrip("-").isdecimal():
            value = int(value) if value.isascii() else value
        elif isinstance(value, float):
            value = _whole(value, pointer)
        if isinstance(value, int) and not isinstance(value, bool):
            return checked(value, pointer)
        return value

    low = max(bottom, -SAFE_INTEGER) if outward else bottom
    high = min(top, SAFE_INTEGER) if outward else top

    def quick(kinds: set[type], value: Any) -> bool:
        return kinds == {int} and low <= min(value) and max(value) <= high

    return (out if outward else into), quick


def _whole(value: Any, _pointer: str) -> Any:
    """Convert 54.0 to 54, as JSON Schema allows."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _whole_list_node(value: Any, pointer: str) -> Any:
    """Convert integral floats in a list of integers, if there are any: lists may be very long."""
    if is_sequence(value) and float in set(map(type, value)):
        return [_whole(v, pointer) for v in value]
    return value


def _chain(nodes: list[Node]) -> Node:
    """Apply several conversions in sequence."""
    live = [node for node in nodes if node is not _same]
    if len(live) < 2:
        return live[0] if live else _same

    def node(value: Any, pointer: str) -> Any:
        for each in live:
            value = each(value, pointer)
        return value

    return node


def _list_node(item: Node, quick: Quick | None) -> Node:
    if item is _same:
        return _same

    def node(value: Any, pointer: str) -> Any:
        if is_sequence(value):
            if quick is not None and quick(set(map(type, value)), value):
                return value
            return [item(v, f"{pointer}/{i}") for i, v in enumerate(value)]
        return value

    return node


def _tuple_node(items: list[Node]) -> Node:
    def node(value: Any, pointer: str) -> Any:
        if is_sequence(value) and len(value) == len(items):
            pairs = zip(items, value, strict=True)
            return [n(v, f"{pointer}/{i}") for i, (n, v) in enumerate(pairs)]
        return value

    return node


def _dict_node(item: Node) -> Node:
    if item is _same:
        return _same

    def node(value: Any, pointer: str) -> Any:
        if is_map(value):
            return {k: item(v, f"{pointer}/{_escaped(k)}") for k, v in value.items()}
        return value

    return node


def _struct_node(fields: dict[str, Node]) -> Node:
    def node(value: Any, pointer: str) -> Any:
        if is_map(value):
            return {
                k: fields[k](v, f"{pointer}/{k}") if k in fields else v for k, v in value.items()
            }
        return value

    return node


def _first_of(nodes: list[Node]) -> Node:
    def node(value: Any, pointer: str) -> Any:
        trouble: ValueError | None = None
        for option in nodes:
            try:
                return option(value, pointer)
            except ValueError as error:
                trouble = error
        raise trouble or ValueError(pointer, "fits none of the options")

    return node


def _any_node(value: Any, pointer: str) -> Any:
    kind: type = type(value)  # pyright: ignore[reportUnknownVariableType] - of any type
    if kind in _NEVER_ODD:
        return value
    if kind in _REALS:
        return _number(value)
    if is_sequence(value):
        return _any_list(value, pointer)
    if is_map(value):
        if _are_usual(set(map(type, value.values())), value.values()):
            return value
        return {k: _any_node(v, pointer) for k, v in value.items()}
    if isinstance(value, msgspec.Struct):
        return _any_node(msgspec.to_builtins(value), pointer)
    return value


def _any_list(value: Any, pointer: str) -> Any:
    """Convert a list; a call per element would be too slow for a million numbers."""
    kinds = set(map(type, value))
    if _are_usual(kinds, value):
        return value
    low, high = -SAFE_INTEGER, SAFE_INTEGER
    if kinds == {int}:
        return [v if low <= v <= high else str(v) for v in value]
    if _USUAL.issuperset(kinds):
        return [v if type(v) in _NEVER_ODD or low <= v <= high else _number(v) for v in value]
    return [_any_node(v, pointer) for v in value]


def _number(value: float) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else _spelled(value)
    return value if -SAFE_INTEGER <= value <= SAFE_INTEGER else str(value)
