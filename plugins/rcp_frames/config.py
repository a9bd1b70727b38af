"""The configuration of frames: places on the earth."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import ConfigError
from rcp_kernel.spi import Anchor

__all__ = ["EARTH", "FramesConfig", "Origin", "check"]

EARTH = "earth"
_Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
_RESERVED = (EARTH, "map", "odom", "base_link")


class Origin(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A local frame on the earth, that clients may name for every robot that knows where it is."""

    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
    altitude: Annotated[float, Meta(extra_json_schema={"unit": "m"})] = 0.0
    """Above mean sea level."""
    axes: Literal["enu", "ned"] = "enu"
    """x east, y north, z up; or x north, y east, z down."""
    tenant: str | None = None
    """The tenant for whose robots it is; default: all."""


class FramesConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[features.frames]`."""

    max_age: Annotated[float, Meta(gt=0, le=60, extra_json_schema={"unit": "s"})] = 2.0
    """Time between a value and the pose that converts it, at most."""
    anchors: dict[str, Anchor] = {}
    """Where a frame of a robot is on the earth, by robot: `/tenant/alpha` or `/tenant/alpha/r1`."""
    origins: dict[_Name, Origin] = {}
    """Further frames, by name."""


def check(config: FramesConfig, _: object) -> None:
    """Check the names.

    :raises ConfigError: an origin has the name of a frame that robots have.
    """
    for name in config.origins:
        if name in _RESERVED:
            raise ConfigError(
                f"[features.frames]: '{name}' is a frame of robots; rename the origin"
            )
    for place in config.anchors:
        if not place.startswith("/tenant/"):
            raise ConfigError(f"[features.frames]: '{place}' is not a robot, like /tenant/alpha/r1")
