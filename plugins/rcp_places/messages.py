"""The data types of places."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import InvalidValue

__all__ = ["EARTH", "EVERYONE", "Edit", "Name", "Place", "Position", "Shape", "check_shape"]

EARTH = "earth"
EVERYONE = "*"
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Metres = Annotated[float, Meta(extra_json_schema={"unit": "m"})]


class Position(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """`latitude` and `longitude` in the frame `earth`, otherwise `x` and `y`."""

    x: Metres | None = None
    y: Metres | None = None
    z: Metres | None = None
    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})] | None = None
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})] | None = (
        None
    )
    altitude: Metres | None = None
    """Above mean sea level."""


class Shape(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Where a place is."""

    description: Annotated[str, Meta(max_length=200)] = ""
    frame: Annotated[str, Meta(min_length=1, max_length=64)] = EARTH
    """`earth`, or a frame of the tenant's robots, such as `map`."""
    position: Position | None = None
    """Default: the middle of `corners`."""
    yaw: Annotated[float, Meta(extra_json_schema={"unit": "rad"})] | None = None
    """Heading of a robot that goes there, in `frame`; default: as the robot likes."""
    radius: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m"})] | None = None
    """Extent of a round place."""
    corners: Annotated[tuple[Position, ...], Meta(max_length=64)] = ()
    """The corners of an area."""


class Place(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """One place as it is listed."""

    name: Name
    tenant: str
    """Whose place it is; `*`: that of all."""
    by: str | None = None
    """Who set it; absent: the configuration."""


class Edit(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A change of one place."""

    do: Literal["set", "remove"] = "set"
    name: Name
    tenant: str | None = None
    """Default: the session's. `*`: the place is that of all, for principals of all tenants."""
    robot: Annotated[str, Meta(max_length=200)] | None = None
    """Path of a robot, such as `/tenant/alpha`: the place is where it is now."""


def check_shape(shape: Shape) -> None:
    """Refuse a place without a position in its frame.

    :raises InvalidValue: names the field.
    """
    if shape.position is None and len(shape.corners) < 3:
        raise InvalidValue(
            "a place needs `position`, or at least 3 `corners`", details={"pointer": "/position"}
        )
    fields = ("latitude", "longitude") if shape.frame == EARTH else ("x", "y")
    other = {"latitude", "longitude", "altitude", "x", "y", "z"} - {*fields}
    other -= {"altitude"} if shape.frame == EARTH else {"z"}
    given = (shape.position,) if shape.position is not None else ()
    for one in (*given, *shape.corners):
        wrong = next((name for name in sorted(other) if getattr(one, name) is not None), None)
        if wrong is not None or any(getattr(one, name) is None for name in fields):
            raise InvalidValue(
                f"a position in the frame '{shape.frame}' has `{fields[0]}` and `{fields[1]}`",
                details={"pointer": "/position" if shape.position is one else "/corners"},
            )
