"""Types of a simulated robot's own resources; those of its profiles are the profiles'."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.types import AngularVelocity, LinearAcceleration, Pose, Quaternion, Time, Twist

__all__ = [
    "Force",
    "Imu",
    "Odometry",
    "Reset",
    "SimulationState",
    "Torque",
    "Wrench",
]

_Newton = Annotated[float, Meta(extra_json_schema={"unit": "N"})]
_NewtonMetre = Annotated[float, Meta(extra_json_schema={"unit": "N.m"})]
_Seconds = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
_Factor = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "1"})]
_Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]
_Seed = Annotated[int, Meta(ge=0, lt=2**32, extra_json_schema={"unit": "1"})]


class Imu(Struct, frozen=True, forbid_unknown_fields=True):
    """An inertial measurement in the frame of its site; at rest, gravity is measured upwards."""

    angular_velocity: AngularVelocity
    linear_acceleration: LinearAcceleration
    orientation: Annotated[
        Quaternion | None, Meta(description="Null: the model measures none.")
    ] = None
    frame_id: str = "imu"
    timestamp: Time | None = None


class Odometry(Struct, frozen=True, forbid_unknown_fields=True):
    """Pose and velocity by dead reckoning from the wheels."""

    pose: Pose
    twist: Twist
    frame_id: str = "odom"
    child_frame_id: str = "base_link"
    timestamp: Time | None = None


class Force(Struct, frozen=True, forbid_unknown_fields=True):
    """A force."""

    x: _Newton
    y: _Newton
    z: _Newton


class Torque(Struct, frozen=True, forbid_unknown_fields=True):
    """A torque about the axes."""

    x: _NewtonMetre
    y: _NewtonMetre
    z: _NewtonMetre


class Wrench(Struct, frozen=True, forbid_unknown_fields=True):
    """A force and a torque in the frame of a site, of what is beyond it on what is before it."""

    force: Force
    torque: Torque
    frame_id: str
    timestamp: Time | None = None


class SimulationState(Struct, frozen=True, forbid_unknown_fields=True):
    """The state of the simulation."""

    time: Annotated[_Seconds, Meta(description="Simulated since the last reset.")]
    paused: bool
    real_time_factor: Annotated[_Factor, Meta(description="As measured of late.")]
    resets: _Count
    brakes: Annotated[bool, Meta(description="Whether the brakes are applied.")]
    fault: Annotated[
        str | None, Meta(description="Why it has stopped for good; `service/reset` starts it.")
    ] = None


class Reset(Struct, frozen=True, forbid_unknown_fields=True):
    """Options of a reset."""

    seed: Annotated[_Seed | None, Meta(description="Of the noise; null: as it goes on.")] = None
