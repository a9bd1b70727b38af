"""The configuration of a differential drive."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import Name

__all__ = ["DiffDriveConfig"]

Metres = Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m"})]


class DiffDriveConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wheels' motors and the geometry."""

    left: Name
    right: Name
    track: Metres
    """Distance between the wheels."""
    radius: Metres
    """Radius of a wheel."""
    valid_for: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})] = 0.5
    """Validity of a velocity in s, before the dead-man sends zero."""
    speed: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "m/s"})] | None = None
    """Maximum speed; without it, the wheels' limits alone apply."""
    turn_rate: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s"})] | None = None
    """Maximum yaw rate; without it, the wheels' limits alone apply."""
    acceleration: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "m/s2"})] | None = None
    """Acceleration of a wheel on the floor; the smaller of this and the motors' own applies."""
    as_robot: bool = False
    """Offer `actuator/cmd_vel`, not `actuator/<name>/cmd_vel`: the backend's robot is this drive."""

    def __post_init__(self) -> None:
        if self.left == self.right:
            raise ValueError("`left` and `right` are the same motor")
