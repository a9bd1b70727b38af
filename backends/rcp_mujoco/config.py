"""The configuration of a simulated robot: its model, its pace, and its parts."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = ["ArmConfig", "GripperConfig", "MujocoConfig", "WheelsConfig"]

Factor = Annotated[float, Meta(gt=0, le=1000, extra_json_schema={"unit": "1"})]
Rate = Annotated[float, Meta(ge=1, le=1000, extra_json_schema={"unit": "Hz"})]
_Length = Annotated[float, Meta(gt=0, le=10, extra_json_schema={"unit": "m"})]
_Speed = Annotated[float, Meta(gt=0, le=50, extra_json_schema={"unit": "m/s"})]
_Acceleration = Annotated[float, Meta(gt=0, le=50, extra_json_schema={"unit": "m/s2"})]
_Turn = Annotated[float, Meta(gt=0, le=50, extra_json_schema={"unit": "rad/s"})]
_TurnAcceleration = Annotated[float, Meta(gt=0, le=500, extra_json_schema={"unit": "rad/s2"})]
_Tolerance = Annotated[float, Meta(gt=0, le=1, extra_json_schema={"unit": "rad"})]
_Seconds = Annotated[float, Meta(gt=0, le=3600, extra_json_schema={"unit": "s"})]
_Ratio = Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "1"})]
_Control = Annotated[float, Meta(extra_json_schema={"unit": "1"})]
_Pixels = Annotated[int, Meta(ge=16, le=4096, extra_json_schema={"unit": "1"})]
_Seed = Annotated[int, Meta(ge=0, lt=2**32, extra_json_schema={"unit": "1"})]
_Names = Annotated[tuple[str, ...], Meta(min_length=1, max_length=64)]


class WheelsConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """A differential drive: velocity actuators on the wheels of each side."""

    left: _Names
    right: _Names
    radius: _Length
    track: Annotated[_Length, Meta(description="Distance between the wheels' centres.")]
    base: str = "base_link"
    """The body whose pose is the robot's pose."""
    speed: _Speed = 1.0
    turn: _Turn = 2.0
    acceleration: _Acceleration = 1.5


class ArmConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """A chain of joints with position actuators."""

    joints: _Names
    """The actuators, from the base to the tool."""
    tool: str | None = None
    """The site whose pose is the tool pose; without it there is no `move_tool`."""
    base: str = "base_link"
    """The body in whose frame the tool pose is reported."""
    speed: _Turn = 1.5
    acceleration: _TurnAcceleration = 4.0
    tolerance: _Tolerance = 0.02
    """Position tolerance of each joint at its goal."""


class GripperConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Fingers driven by one position actuator."""

    actuator: str
    open: _Control
    """The actuator's value with the fingers open."""
    closed: _Control
    contacts: tuple[str, ...] = ()
    """Touch sensors of the pads; without them it is unknown whether an object is held."""
    width: _Ratio = 2.0
    """Opening in metres per metre of actuator travel."""


class MujocoConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One robot in a simulation of its own."""

    model: str = "rover"
    """`rover` or `arm`, or the path of an MJCF or URDF file."""
    real_time_factor: Factor = 1.0
    paused: bool = False
    """Whether it starts paused."""
    seed: _Seed = 0
    """Seed of the sensor noise."""
    keyframe: str | None = None
    """Keyframe of the initial state, also used by resets; by default the model's first."""
    rate: Rate = 50.0
    """How often sensors are published, in wall-clock time."""
    valid_for: _Seconds = 0.5
    """Validity of a velocity or force, in seconds of simulation time."""
    stalled_after: _Seconds = 1.0
    """Seconds without progress of the stepping thread, after which it is reported."""
    actuate: Literal["position", "velocity", "torque"] | None = None
    """Adds an actuator of this kind to each joint that has none; a URDF has none."""
    cameras: bool = True
    camera_rate: Rate = 5.0
    camera_width: _Pixels = 320
    camera_height: _Pixels = 240
    wheels: WheelsConfig | None = None
    arm: ArmConfig | None = None
    gripper: GripperConfig | None = None
