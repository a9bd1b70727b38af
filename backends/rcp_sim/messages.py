"""Types of the simulated rover's resources; metres, radians, seconds, volts."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_kernel.types import (
    AngularVelocity,
    LinearAcceleration,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Ratio,
    Time,
    Twist,
)
from rcp_profiles import messages

__all__ = [
    "FULL_TURN",
    "TOP_SPEED",
    "TOP_TURN",
    "Battery",
    "Boot",
    "Box",
    "ClearFaults",
    "Dock",
    "DockResult",
    "FaultEvent",
    "FaultSpec",
    "FaultsActive",
    "Image",
    "Imu",
    "MoveFeedback",
    "MoveResult",
    "MoveTo",
    "ObstacleId",
    "Obstacles",
    "OccupancyGrid",
    "Odometry",
    "ResetResult",
    "ResetSystem",
    "TaskEvent",
]

TOP_SPEED = 2.5  # m/s, limit of the motors
TOP_TURN = 2.0  # rad/s
FULL_TURN = 6.2832  # rad

_Place = Annotated[float, Meta(ge=-1000, le=1000, extra_json_schema={"unit": "m"})]
_Length = Annotated[float, Meta(ge=0.05, le=50, extra_json_schema={"unit": "m"})]
_Count = Annotated[int, Meta(ge=0, le=2**31, extra_json_schema={"unit": "1"})]
_Seconds = Annotated[float, Meta(ge=0, le=86_400, extra_json_schema={"unit": "s"})]
_Distance = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m"})]
_Duration = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
_Volts = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "V"})]
_Energy = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "W.h"})]
_Amperes = Annotated[
    float, Meta(description="Negative while discharging.", extra_json_schema={"unit": "A"})
]
_Cell = Annotated[
    float, Meta(gt=0, description="Edge length of a cell.", extra_json_schema={"unit": "m"})
]
_Miss = Annotated[
    float, Meta(ge=0, description="Distance from the goal.", extra_json_schema={"unit": "m"})
]
_Delay = Annotated[
    float,
    Meta(
        gt=0,
        le=60,
        description="Delay of every response with `slow`.",
        extra_json_schema={"unit": "s"},
    ),
]
_Losses = Annotated[
    int,
    Meta(
        ge=1,
        le=100,
        description="Number of stops lost with `stop_lost`.",
        extra_json_schema={"unit": "1"},
    ),
]


class Odometry(Struct, frozen=True, forbid_unknown_fields=True):
    """Pose and velocity by dead reckoning from the wheels; drifts with wheel slip."""

    pose: Pose
    twist: Twist
    frame_id: str = "odom"
    child_frame_id: str = "base_link"
    timestamp: Time | None = None


class Imu(Struct, frozen=True, forbid_unknown_fields=True):
    """An inertial measurement in the body frame; at rest z reads gravity."""

    orientation: Quaternion
    angular_velocity: AngularVelocity
    linear_acceleration: LinearAcceleration
    frame_id: str = "base_link"
    timestamp: Time | None = None


class Battery(Struct, frozen=True, forbid_unknown_fields=True):
    """The state of a lithium pack of three cells."""

    voltage: _Volts
    current: _Amperes
    percentage: Ratio
    energy: _Energy
    charging: bool = False
    timestamp: Time | None = None


class Image(Struct, frozen=True, forbid_unknown_fields=True):
    """An image as a PNG file."""

    width: _Count
    height: _Count
    data: bytes
    format: Literal["png"] = "png"
    frame_id: str = "camera"
    timestamp: Time | None = None


class OccupancyGrid(Struct, frozen=True, forbid_unknown_fields=True):
    """A map in cells, row by row from `origin`: 0 free, 100 occupied."""

    resolution: _Cell
    width: _Count
    height: _Count
    origin: Pose
    data: bytes
    frame_id: str = "map"
    timestamp: Time | None = None


class MoveTo(messages.MoveTo, frozen=True, forbid_unknown_fields=True):
    """A goal on the map; `position.z` is ignored, because the floor is flat."""

    orientation: Annotated[
        Quaternion | None, Meta(description="Heading at the goal; give this, `yaw` or neither.")
    ] = None


class MoveFeedback(Struct, frozen=True, forbid_unknown_fields=True):
    """Progress of a drive."""

    distance_remaining: _Distance
    eta: Annotated[_Duration | None, Meta(description="None if the speed limit is 0.")]
    phase: Literal["turning", "driving", "aligning", "braking", "done"]
    position: Point


class MoveResult(Struct, frozen=True, forbid_unknown_fields=True):
    """End position, distance and duration of a drive."""

    pose: PoseStamped
    distance: _Distance
    duration: _Duration
    error: _Miss


class Dock(Struct, frozen=True, forbid_unknown_fields=True):
    """No parameters: the charger is at the start position."""


class DockResult(Struct, frozen=True, forbid_unknown_fields=True):
    """State of the rover on its charger."""

    pose: PoseStamped
    percentage: Ratio
    charging: bool


class ResetSystem(Struct, frozen=True, forbid_unknown_fields=True):
    """What to reset; without input, everything except the rover's position and its battery."""

    odometry: bool = True
    faults: bool = True
    obstacles: bool = True
    speed_limit: bool = True
    pose: Annotated[bool, Meta(description="Put the rover back at its start.")] = False
    battery: Annotated[bool, Meta(description="Replace the battery with a full one.")] = False


class ResetResult(Struct, frozen=True, forbid_unknown_fields=True):
    """What the reset did."""

    faults_cleared: _Count
    obstacles_removed: _Count
    pose: PoseStamped


class Box(Struct, frozen=True, forbid_unknown_fields=True):
    """An upright box on the floor, aligned with the axes of the map."""

    x: _Place
    y: _Place
    size_x: _Length
    size_y: _Length


class ObstacleId(Struct, frozen=True, forbid_unknown_fields=True):
    """The name of a placed box."""

    id: Annotated[str, Meta(max_length=32)]


class Obstacles(Struct, frozen=True, forbid_unknown_fields=True):
    """The placed boxes."""

    placed: dict[str, Box]


class FaultSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """A fault to inject."""

    fault: Literal["sensor_stop", "refuse", "slow", "link_lost", "stop_lost", "crash"]
    target: Annotated[
        str | None,
        Meta(
            description="The affected resource (`sensor/scan`). Default: all that support the fault."
        ),
    ] = None
    seconds: Annotated[
        _Seconds | None,
        Meta(description="Duration. Default: until cleared, or 10 s for `link_lost`."),
    ] = None
    delay: _Delay = 1.0
    count: _Losses = 1


class FaultsActive(Struct, frozen=True, forbid_unknown_fields=True):
    """The active injected faults."""

    active: list[FaultSpec]


class ClearFaults(Struct, frozen=True, forbid_unknown_fields=True):
    """The kind of injected fault to end; None ends all of them."""

    fault: Literal["sensor_stop", "refuse", "slow", "link_lost", "stop_lost"] | None = None


class Boot(Struct, frozen=True, forbid_unknown_fields=True):
    """The rover started."""

    reason: Literal["power_on", "reset"]
    model: str
    message: str
    timestamp: Time | None = None


class FaultEvent(Struct, frozen=True, forbid_unknown_fields=True):
    """A fault appeared (`active`) or cleared."""

    fault: Literal[
        "none",
        "collision",
        "battery_low",
        "battery_empty",
        "sensor_stop",
        "refuse",
        "slow",
        "link_lost",
        "stop_lost",
        "crash",
    ]
    active: bool
    message: str
    target: str | None = None
    timestamp: Time | None = None


class TaskEvent(Struct, frozen=True, forbid_unknown_fields=True):
    """A task of the rover started or ended."""

    task: Literal["none", "move_to", "dock"]
    state: Literal["idle", "started", "completed", "cancelled", "failed"]
    message: str
    goal: Point | None = None
    position: Point | None = None
    timestamp: Time | None = None
