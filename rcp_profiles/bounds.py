"""Types with the limits of one robot: copies of profile types with bounded numbers."""

from __future__ import annotations

import types
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Union, get_args, get_origin

import msgspec
from msgspec import NODEFAULT, Meta, Struct

from rcp_protocol.errors import PluginError

__all__ = ["Bound", "Bounds", "Keyed", "bounded", "twist_limits"]

Bound = tuple[float | None, float | None]
"""The lowest and the highest value; None: no bound on that side."""
Bounds = Mapping[str, Bound]
"""By the place in the value: `linear.x`, or an empty text for the value itself. Lists are passed
through (`points.positions.elbow`); a map has the given keys only, each of them optional."""


_AXES = ("linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z")


class Keyed(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A map with known keys, which `bounded` substitutes for a `dict`."""

    def given(self) -> dict[str, Any]:
        """Return the given items by key."""
        fields = msgspec.structs.fields(self)
        found = {one.encode_name: getattr(self, one.name) for one in fields}
        return {key: value for key, value in found.items() if value is not None}


def twist_limits(*, x: float, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Bounds:
    """Return the bounds of a velocity: m/s ahead and back, to the sides, up and down, and rad/s.

    What is 0 the robot cannot do; it does not roll or pitch.
    """
    most = {"linear.x": x, "linear.y": y, "linear.z": z, "angular.z": yaw}
    return {place: (-most.get(place, 0.0), most.get(place, 0.0)) for place in _AXES}


def bounded(type_: Any, bounds: Bounds) -> Any:
    """Return a type with bounds; its Structs are subclasses of those of `type_`.

    :raises PluginError: a bound does not name a number of the type.
    """
    return _bounded(type_, bounds, "Keyed")


def _bounded(type_: Any, bounds: Bounds, name: str) -> Any:
    """Return a type with bounds; `name` is that of a map in it, different for each in a schema."""
    if not bounds:
        return type_
    if (own := bounds.get("")) is not None:
        if len(bounds) > 1:
            raise PluginError("bounds of a value and of its parts exclude each other")
        return _number(type_, own)
    origin, args = get_origin(type_), get_args(type_)
    if origin is Annotated:
        return Annotated[(_bounded(args[0], bounds, name), *args[1:])]  # pyright: ignore[reportInvalidTypeForm]
    if origin in (Union, types.UnionType):
        made = (arg if arg is type(None) else _bounded(arg, bounds, name) for arg in args)
        return Union[tuple(made)]  # noqa: UP007 - made of a list
    if origin is list:
        return list[_bounded(args[0], bounds, name)]
    if origin is dict:
        return _keyed(args[1], bounds, name)
    if isinstance(type_, type) and issubclass(type_, Struct):
        return _struct(type_, tuple(sorted(bounds.items())))
    raise PluginError(f"{', '.join(bounds)}: {type_!r} has no such part")


def _number(type_: Any, bound: Bound) -> Any:
    if get_origin(type_) in (Union, types.UnionType):
        inner = [a if a is type(None) else _number(a, bound) for a in get_args(type_)]
        return Union[tuple(inner)]  # noqa: UP007 - made of a list
    bare, *metas = get_args(type_) if get_origin(type_) is Annotated else (type_,)
    if bare not in (int, float):
        raise PluginError(f"{type_!r} is no number, and has no bounds")
    low, high = bound
    kept = [_without(meta, low=low is not None, high=high is not None) for meta in metas]
    return Annotated[(bare, *kept, Meta(ge=low, le=high))]  # pyright: ignore[reportInvalidTypeForm]


def _without(meta: Any, *, low: bool, high: bool) -> Any:
    """Take the bounds out of a Meta that others take the place of: msgspec allows one a side."""
    if not isinstance(meta, Meta):
        return meta
    gone = [*(("ge", "gt") if low else ()), *(("le", "lt") if high else ())]
    facts = {name: value for name, value in meta.__rich_repr__() if name not in gone}
    return Meta(**facts)


def _parts(bounds: Bounds) -> dict[str, dict[str, Bound]]:
    """Group bounds by the first step of their places."""
    found: dict[str, dict[str, Bound]] = {}
    for place, bound in bounds.items():
        first, _, rest = place.partition(".")
        found.setdefault(first, {})[rest] = bound
    return found


@lru_cache(maxsize=1024)
def _struct(type_: type[Struct], bounds: tuple[tuple[str, Bound], ...]) -> type[Struct]:
    """Make a Struct with bounds, once: a resource that is declared again must have the same types."""
    parts = _parts(dict(bounds))
    fields: list[tuple[str, Any, Any]] = []
    for field in msgspec.structs.fields(type_):
        name = type_.__name__ + field.encode_name.title().replace("_", "")
        made = _bounded(field.type, parts.pop(field.encode_name, {}), name)
        fields.append((field.name, made, _default(field, made)))
    if parts:
        raise PluginError(f"{type_.__name__} has no field {', '.join(parts)}")
    config = type_.__struct_config__
    return msgspec.defstruct(
        type_.__name__,
        fields,
        bases=(type_,),
        namespace={"__doc__": type_.__doc__},
        module=type_.__module__,
        frozen=config.frozen,
        forbid_unknown_fields=config.forbid_unknown_fields,
        kw_only=True,
    )


def _default(field: Any, made: Any) -> Any:
    """Return the default of a field, as a value of its bounded type."""
    if field.default is not NODEFAULT:
        value = field.default
    elif field.default_factory is not NODEFAULT:
        value = field.default_factory()
    else:
        return NODEFAULT
    if isinstance(value, Struct):
        value = msgspec.convert(msgspec.to_builtins(value), made)
    return value


def _keyed(type_: Any, bounds: Bounds, name: str) -> type[Struct]:
    fields: list[tuple[str, Any, Any]] = []
    for number, (key, own) in enumerate(_parts(bounds).items()):
        made = _bounded(type_, own, f"{name}{number}")
        fields.append((f"key_{number}", made | None, msgspec.field(name=key, default=None)))
    return msgspec.defstruct(
        name,
        fields,
        bases=(Keyed,),
        namespace={"__doc__": "Values by name."},
        frozen=True,
        forbid_unknown_fields=True,
        kw_only=True,
    )
