"""The types of the profiles' resources: SI units; a field that may be null is not always known.

An input's optional fields may be left out, and null means the robot's own choice. Results and
feedback have no optional fields: what may be missing is null.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_protocol.types import (
    AngularVelocity,
    LinearVelocity,
    Metres,
    Point,
    PoseStamped,
    Quaternion,
    Radians,
    Ratio,
    Time,
)

__all__ = [
    "Armed",
    "Attitude",
    "BatteryState",
    "FollowTrajectory",
    "GnssFix",
    "GoalPoint",
    "GripperState",
    "Height",
    "Image",
    "JointPositions",
    "JointStates",
    "JointsMoved",
    "MoveFeedback",
    "MoveGripper",
    "MoveJoints",
    "MoveJointsFeedback",
    "MoveResult",
    "MoveTo",
    "MoveTool",
    "TakeOff",
    "TrajectoryFeedback",
    "TwistStamped",
    "Waypoint",
]

_FrameName = Annotated[str, Meta(min_length=1, max_length=64)]
_GoalFrame = Annotated[
    _FrameName,
    Meta(
        description="The frame of the goal: one of the robot's own, such as `map`, or another that the gateway converts "
        "from: `base_link`, a configured origin, or `earth`, with `latitude`, `longitude` and `altitude` as `position`."
    ),
]
_ToolFrame = Annotated[_FrameName, Meta(description="The frame of the goal, of the robot's own.")]
_Left = Annotated[
    float, Meta(ge=0, description="Distance to the goal.", extra_json_schema={"unit": "m"})
]
_TimeLeft = Annotated[
    float,
    Meta(
        ge=0,
        description="Estimated time left; null if it is not known.",
        extra_json_schema={"unit": "s"},
    ),
]
_Error = Annotated[
    float,
    Meta(ge=0, description="Distance from the goal at the end.", extra_json_schema={"unit": "m"}),
]
_Tolerance = Annotated[
    float,
    Meta(
        gt=0,
        description="Distance from the goal that counts as reached.",
        extra_json_schema={"unit": "m"},
    ),
]
_Speed = Annotated[
    float,
    Meta(
        gt=0,
        description="Maximum speed; the robot's limits apply as well.",
        extra_json_schema={"unit": "m/s"},
    ),
]
_Altitude = Annotated[
    float,
    Meta(
        description="Above the place where the robot took off, up positive.",
        extra_json_schema={"unit": "m"},
    ),
]
_Duration = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
_Effort = Annotated[
    float, Meta(description="N for a prismatic joint.", extra_json_schema={"unit": "N.m"})
]
_Part = Annotated[
    float,
    Meta(gt=0, le=1, description="Part of the highest speed.", extra_json_schema={"unit": "1"}),
]
_Width = Annotated[
    float, Meta(ge=0, description="Distance between the fingers.", extra_json_schema={"unit": "m"})
]
_Count = Annotated[int, Meta(ge=0, le=2**31, extra_json_schema={"unit": "1"})]
JointPositions = dict[
    str,
    Annotated[
        float, Meta(description="m for a prismatic joint.", extra_json_schema={"unit": "rad"})
    ],
]
JointVelocities = dict[
    str,
    Annotated[
        float, Meta(description="m/s for a prismatic joint.", extra_json_schema={"unit": "rad/s"})
    ],
]


class TwistStamped(Struct, frozen=True, forbid_unknown_fields=True):
    """A measured velocity, in a named frame at a time."""

    linear: LinearVelocity
    angular: AngularVelocity
    frame_id: str = "base_link"
    timestamp: Time | None = None


class GoalPoint(Struct, frozen=True, forbid_unknown_fields=True):
    """The position of a goal, in metres."""

    x: Metres
    y: Metres
    z: Annotated[
        Metres | None,
        Meta(
            description="Null: an aircraft keeps its height. A robot that keeps to the ground ignores it."
        ),
    ] = None


class MoveTo(Struct, frozen=True, forbid_unknown_fields=True):
    """A place to go to; the same for whatever drives, flies or swims."""

    position: GoalPoint
    frame: _GoalFrame = "map"
    yaw: (
        Annotated[
            Radians, Meta(description="Heading at the goal, counter-clockwise from x of the frame.")
        ]
        | None
    ) = None
    tolerance: _Tolerance | None = None
    speed: _Speed | None = None


class MoveFeedback(Struct, frozen=True, forbid_unknown_fields=True):
    """How far it still is."""

    distance_remaining: _Left
    eta: _TimeLeft | None


class MoveResult(Struct, frozen=True, forbid_unknown_fields=True):
    """Where it arrived, as measured; null if the robot has no measurement in the frame of the goal."""

    pose: PoseStamped | None
    error: _Error | None


class Attitude(Struct, frozen=True, forbid_unknown_fields=True):
    """The orientation of the body, and how fast it turns."""

    orientation: Quaternion
    angular_velocity: AngularVelocity
    frame_id: str = "map"
    timestamp: Time | None = None


class GnssFix(Struct, frozen=True, forbid_unknown_fields=True):
    """A position by satellites; null while there is none."""

    fix: Literal["none", "2d", "3d", "dgnss", "rtk_float", "rtk_fixed"]
    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})] | None
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})] | None
    altitude: (
        Annotated[float, Meta(description="Above mean sea level.", extra_json_schema={"unit": "m"})]
        | None
    )
    satellites: _Count | None
    horizontal_accuracy: (
        Annotated[
            float,
            Meta(ge=0, description="One standard deviation.", extra_json_schema={"unit": "m"}),
        ]
        | None
    )
    timestamp: Time | None = None


class Armed(Struct, frozen=True, forbid_unknown_fields=True):
    """Whether the motors are armed."""

    armed: bool


class TakeOff(Struct, frozen=True, forbid_unknown_fields=True):
    """How high to climb."""

    altitude: Annotated[
        float,
        Meta(
            gt=0, description="Above the place where it takes off.", extra_json_schema={"unit": "m"}
        ),
    ]


class Height(Struct, frozen=True, forbid_unknown_fields=True):
    """The present height."""

    altitude: _Altitude


class JointStates(Struct, frozen=True, forbid_unknown_fields=True):
    """The joints of a robot: the lists have one element for each name, or none at all."""

    name: list[str]
    position: list[
        Annotated[
            float, Meta(description="m for a prismatic joint.", extra_json_schema={"unit": "rad"})
        ]
    ]
    velocity: list[
        Annotated[
            float,
            Meta(description="m/s for a prismatic joint.", extra_json_schema={"unit": "rad/s"}),
        ]
    ]
    effort: list[_Effort] | None = None
    timestamp: Time | None = None


class MoveJoints(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the joints are to go; one that is not named stays."""

    positions: JointPositions
    speed: _Part = 1.0


class MoveJointsFeedback(Struct, frozen=True, forbid_unknown_fields=True):
    """How far the joints still are."""

    positions: JointPositions
    left: Annotated[
        float,
        Meta(
            ge=0,
            description="Of the joint that is farthest from its goal.",
            extra_json_schema={"unit": "rad"},
        ),
    ]


class JointsMoved(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the joints are at the end."""

    positions: JointPositions
    duration: _Duration


class Waypoint(Struct, frozen=True, forbid_unknown_fields=True):
    """A point of a trajectory."""

    time: Annotated[
        float,
        Meta(
            ge=0,
            description="From the start of the trajectory; increases.",
            extra_json_schema={"unit": "s"},
        ),
    ]
    positions: JointPositions
    velocities: Annotated[
        JointVelocities | None,
        Meta(description="At the point; null: as the controller interpolates."),
    ] = None


class FollowTrajectory(Struct, frozen=True, forbid_unknown_fields=True):
    """A trajectory in joint space, from where the joints are."""

    points: Annotated[list[Waypoint], Meta(min_length=1, max_length=10_000)]


class TrajectoryFeedback(Struct, frozen=True, forbid_unknown_fields=True):
    """How far along the trajectory it is."""

    time: Annotated[
        float, Meta(ge=0, description="Since the start.", extra_json_schema={"unit": "s"})
    ]
    positions: JointPositions
    error: Annotated[
        float,
        Meta(
            ge=0,
            description="Of the joint that is farthest from the trajectory.",
            extra_json_schema={"unit": "rad"},
        ),
    ]


class MoveTool(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the tool is to go."""

    position: Point
    orientation: Annotated[Quaternion | None, Meta(description="Null: any.")] = None
    frame: _ToolFrame = "base_link"
    speed: _Speed | None = None


class GripperState(Struct, frozen=True, forbid_unknown_fields=True):
    """How far a gripper is open, and whether it holds something."""

    width: _Width
    holding: bool | None
    timestamp: Time | None = None


class MoveGripper(Struct, frozen=True, forbid_unknown_fields=True):
    """How far to open or close."""

    width: _Width
    force: (
        Annotated[
            float,
            Meta(
                gt=0,
                description="Stop at this force: something is held.",
                extra_json_schema={"unit": "N"},
            ),
        ]
        | None
    ) = None


class BatteryState(Struct, frozen=True, forbid_unknown_fields=True):
    """What a battery has left."""

    percentage: Annotated[Ratio, Meta(description="Charge that is left: 1 is full.")] | None
    voltage: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "V"})] | None
    current: (
        Annotated[
            float, Meta(description="Negative while discharging.", extra_json_schema={"unit": "A"})
        ]
        | None
    )
    charging: bool | None = None
    timestamp: Time | None = None


class Image(Struct, frozen=True, forbid_unknown_fields=True):
    """An image as a file."""

    width: _Count
    height: _Count
    data: bytes
    format: Literal["jpeg", "png"]
    frame_id: str = "camera"
    timestamp: Time | None = None
