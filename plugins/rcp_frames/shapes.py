"""What of a value's type depends on its frame; found out once per type."""

from __future__ import annotations

import math
import types
from functools import cache
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

import msgspec
from msgspec import Meta
from msgspec.structs import FieldInfo, fields, replace

from rcp_frames.moves import GeoPoint, Move
from rcp_geometry import Rigid
from rcp_geometry.rigid import Quat, Vec
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import ValueType, value_type

__all__ = ["Shape", "shape_of"]

_LEAST = 0.5  # norm of a quaternion, which nodes leave 0 where they do not know it
_XYZ, _XYZW = ("x", "y", "z"), ("x", "y", "z", "w")
_Heading = Annotated[
    float,
    Meta(
        ge=0,
        description="Of the x axis, clockwise from north.",
        extra_json_schema={"unit": "rad"},
    ),
]


class _Part(NamedTuple):
    """The fields of one struct that depend on the frame."""

    position: str | None = None
    orientation: str | None = None
    vectors: tuple[str, ...] = ()


class _Level(NamedTuple):
    """A struct with such fields, or with structs that have them."""

    part: _Part
    inner: dict[str, _Level]
    covariance: str | None
    """36 numbers about position and rotation, or their rates, along the axes of the frame."""
    earth: Any
    """Its type with latitude, longitude and altitude."""

    def moved(self, value: Any, move: Move) -> Any:
        """Return a value in another frame."""
        part, changes = self.part, {name: one.moved(getattr(value, name), move) for name, one in self.inner.items()}  # fmt: skip
        if part.position is not None:
            place = getattr(value, part.position)
            changes[part.position] = move.place(place, _vec(place))
        if part.orientation is not None:
            orientation = getattr(value, part.orientation)
            at = None if part.position is None else _vec(getattr(value, part.position))
            turned = move.turned(_quat(orientation), at)
            changes[part.orientation] = replace(
                orientation, **dict(zip(_XYZW, turned, strict=True))
            )
            if move.geographic:
                changes["heading"] = move.heading(turned)
        for name in part.vectors:
            vector = getattr(value, name)
            along = move.vector(_vec(vector))
            changes[name] = replace(vector, **dict(zip(_XYZ, along, strict=True)))
        if self.covariance is not None:
            changes[self.covariance] = move.covariance(getattr(value, self.covariance))
        if not move.geographic:
            return replace(value, **changes)
        kept = {name: getattr(value, name) for name in value.__struct_fields__}
        return self.earth(**{**kept, **changes})


class Shape:
    """A type whose values name their frame."""

    def __init__(self, type_: Any, frame: tuple[str, ...], level: _Level) -> None:
        self._frame = frame
        self._level = level
        self.default = _default(type_, frame)
        """The frame of values that have not been seen yet."""
        self.type = value_type(type_)
        self._child = "child_frame_id" if hasattr(type_, "child_frame_id") else None

    @property
    def earth(self) -> ValueType:
        """The type of values on the earth."""
        return value_type(self._level.earth)

    def frame_of(self, value: Any) -> str:
        """Return the name of a value's frame."""
        for name in self._frame:
            value = getattr(value, name)
        return str(value).lstrip("/") or self.default

    def current(self, entry: Entry) -> str:
        """Return the frame of a resource's latest value.

        :raises DeviceRejected: it is invalid.
        """
        return self.default if entry.latest is None else self.frame_of(entry.latest.value)

    def child_of(self, value: Any) -> str:
        """Return the frame whose pose a value is."""
        child = "" if self._child is None else getattr(value, self._child)
        return child.lstrip("/") or "base_link"

    def pose_of(self, value: Any) -> Rigid | None:
        """Return the pose in a value; None: it has none, or is not oriented."""
        level = self._level
        while "pose" in level.inner:
            value, level = value.pose, level.inner["pose"]
        part = level.part
        if part.position is None or part.orientation is None:
            return None
        at, rotation = _vec(getattr(value, part.position)), _quat(getattr(value, part.orientation))
        norm = math.hypot(*rotation)
        if norm < _LEAST:
            return None
        x, y, z, w = rotation
        return Rigid(at, (x / norm, y / norm, z / norm, w / norm))

    def moved(self, value: Any, move: Move) -> Any:
        """Return a value in the frame of a move."""
        moved = self._level.moved(value, move)
        name, *rest = self._frame
        inner: Any = move.target
        if rest:
            inner = replace(getattr(value, name), **{rest[0]: inner})
        return replace(moved, **{name: inner})


@cache
def shape_of(type_: Any) -> Shape | None:
    """Return what of a type depends on the frame that its values name; None: they name none."""
    known = _fields(type_)
    frame = _frame_of(known)
    if frame is None:
        return None
    level = _level(type_, known, outermost=True)
    return None if level is None else Shape(type_, frame, level)


def _fields(type_: Any) -> dict[str, FieldInfo]:
    type_ = _bare(type_)
    if not (isinstance(type_, type) and issubclass(type_, msgspec.Struct)):
        return {}
    return {field.name: field for field in fields(type_)}


def _bare(type_: Any) -> Any:
    """Return a type without annotations, and without None."""
    if get_origin(type_) is Annotated:
        return _bare(get_args(type_)[0])
    if get_origin(type_) in (Union, types.UnionType):
        left = [one for one in get_args(type_) if one is not type(None)]
        return _bare(left[0]) if len(left) == 1 else type_
    return type_


def _frame_of(known: dict[str, FieldInfo]) -> tuple[str, ...] | None:
    if "frame_id" in known:
        return ("frame_id",) if _bare(known["frame_id"].type) is str else None
    header = _fields(known["header"].type) if "header" in known else {}
    named = "frame_id" in header and _bare(header["frame_id"].type) is str
    return ("header", "frame_id") if named else None


def _default(type_: Any, frame: tuple[str, ...]) -> str:
    default = _fields(type_)[frame[0]].default if len(frame) == 1 else ""
    return default if isinstance(default, str) else ""


def _level(type_: Any, known: dict[str, FieldInfo], *, outermost: bool) -> _Level | None:
    """Return what of a struct depends on the frame; None: nothing does."""
    part = _part(known, outermost=outermost)
    inner: dict[str, _Level] = {}
    for name in ("pose", "transform", *(() if "pose" in known else ("twist", "accel"))):
        below = _fields(known[name].type) if name in known else {}
        if below and (level := _level(known[name].type, below, outermost=False)) is not None:
            inner[name] = level
    if not inner and part == _Part():
        return None
    covariance = "covariance" if inner and "covariance" in known else None
    return _Level(part, inner, covariance, _on_earth(_bare(type_), known, part, inner))


def _part(known: dict[str, FieldInfo], *, outermost: bool) -> _Part:
    for position, orientation in (("position", "orientation"), ("translation", "rotation")):
        if _has(known, position, _XYZ):
            turned = _has(known, orientation, _XYZW)
            return _Part(position, orientation if turned else None)
    if _has(known, "linear", _XYZ) and _has(known, "angular", _XYZ):
        return _Part(vectors=("linear", "angular"))
    if outermost and _has(known, "point", _XYZ):
        return _Part("point")
    if outermost and _has(known, "vector", _XYZ):
        return _Part(vectors=("vector",))
    # An IMU's frame is its own, and not that of its orientation.
    if outermost and _has(known, "orientation", _XYZW) and "linear_acceleration" not in known:
        return _Part(orientation="orientation")
    return _Part()


def _has(known: dict[str, FieldInfo], name: str, names: tuple[str, ...]) -> bool:
    return name in known and set(names) == _fields(known[name].type).keys()


def _on_earth(
    type_: Any, known: dict[str, FieldInfo], part: _Part, inner: dict[str, _Level]
) -> Any:
    """Return a struct's type with places by latitude and longitude, and a heading."""
    own: list[Any] = []
    for field in known.values():
        kind: Any = field.type
        if field.name == part.position:
            kind = GeoPoint
        elif field.name in inner:
            kind = inner[field.name].earth
        own.append(_field(field, kind))
    if part.orientation is not None:
        own.append(("heading", _Heading))
    return msgspec.defstruct(
        f"Earth{type_.__name__}",
        own,
        namespace={"__doc__": f"{type_.__doc__ or type_.__name__} On the earth (WGS 84)."},
        module=__name__,
        frozen=True,
        forbid_unknown_fields=True,
        kw_only=True,
    )


def _field(field: FieldInfo, kind: Any) -> Any:
    if kind is field.type and field.default is not msgspec.NODEFAULT:
        return field.name, kind, field.default
    return field.name, kind


def _vec(value: Any) -> Vec:
    return value.x, value.y, value.z


def _quat(value: Any) -> Quat:
    return value.x, value.y, value.z, value.w
