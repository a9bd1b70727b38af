"""The profiles of moving robots: `drive`, `mobile`, `aerial`, `power`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, structs

from rcp_profiles import messages as m
from rcp_profiles.profile import Definition, Profile
from rcp_protocol.model import Resource
from rcp_protocol.types import PoseStamped, Twist

__all__ = ["AERIAL", "DRIVE", "HOLD", "MOBILE", "POWER"]

_AT = "2026-05-29T14:12:04Z"
_COMMAND = 1.0  # s, age at which a velocity is refused
_GOAL = 30.0  # s, age at which a goal is refused
_LAPSE = 0.5  # s for which a velocity is valid
_SpeedLimit = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s"})]

HOLD = Definition(
    resource=Resource(
        name="service/hold",
        description="Bring the robot to rest and end its commands, without latching an e-stop.",
    ),
    gateway=True,
)
_VELOCITY = Definition(
    resource=Resource(
        name="sensor/velocity",
        description="Measured velocity of the body: x forward, y left, z up; positive yaw rate turns left.",
        value=m.TwistStamped,
        examples=({"linear": {"x": 0.5}, "angular": {"z": 0.1}},),
    ),
    frame="base_link",
)
_CMD_VEL = Definition(
    resource=Resource(
        name="actuator/cmd_vel",
        description="Commanded velocity of the body, in force until the next one or until `valid_for` is over; then the robot stops.",
        value=Twist,
        examples=({"linear": {"x": 0.1}}, {"linear": {"x": 0.1}, "angular": {"z": 0.1}}),
        max_age=_COMMAND,
        valid_for=_LAPSE,
        safe={},
    ),
    frame="base_link",
)
_POSE = Definition(
    resource=Resource(
        name="sensor/pose",
        description="Position and heading of the robot, in the frame that `frame_id` names.",
        value=PoseStamped,
        examples=(
            {"position": {"x": 12.4, "y": 7.8, "z": 0.0}, "frame_id": "map", "timestamp": _AT},
        ),
    ),
    frame="map",
)
_MOVE_TO = Definition(
    resource=Resource(
        name="action/move_to",
        description="Go to a position, and turn to a heading if one is given; completed when the robot is there. "
        "An aeroplane circles around the position. A robot that always faces its direction of travel refuses a heading.",
        input=m.MoveTo,
        output=m.MoveResult,
        feedback=m.MoveFeedback,
        examples=({"position": {"x": 1.0, "y": 0.0}},),
        max_age=_GOAL,
    ),
    frame="map",
)
_SPEED_LIMIT = Definition(
    resource=Resource(
        name="param/speed_limit",
        description="Maximum speed of the robot over the ground, for every command; of an aeroplane its airspeed.",
        value=_SpeedLimit,
        examples=(0.5,),
    ),
)
_ARMED = Definition(
    resource=Resource(
        name="sensor/armed",
        description="Whether the motors are armed.",
        value=bool,
        examples=(False,),
    ),
)
_ATTITUDE = Definition(
    resource=Resource(
        name="sensor/orientation",
        description="Orientation of the body and its angular velocity: body x forward, y left, z up; map x east, y north, z up.",
        value=m.Attitude,
        examples=({"orientation": {"w": 1.0}, "angular_velocity": {"z": 0.1}},),
    ),
    frame="map",
)
_GNSS = Definition(
    resource=Resource(
        name="sensor/gnss",
        description="Position by satellites, on the WGS 84 ellipsoid.",
        value=m.GnssFix,
        examples=(
            {
                "fix": "3d",
                "latitude": -35.3632621,
                "longitude": 149.1652374,
                "altitude": 584.1,
                "satellites": 12,
                "horizontal_accuracy": 1.2,
            },
        ),
    ),
    frame="earth",
)
_ARM = Definition(
    resource=Resource(
        name="action/arm",
        description="Arm the motors, if the robot's own checks allow it.",
        output=m.Armed,
        energises=True,
        max_age=_GOAL,
        timeout=15.0,
    ),
)
_DISARM = Definition(
    resource=Resource(
        name="action/disarm",
        description="Disarm the motors; refused in the air.",
        output=m.Armed,
        max_age=_GOAL,
        timeout=15.0,
    ),
)
_TAKEOFF = Definition(
    resource=Resource(
        name="action/takeoff",
        description="Climb to a height above the place of take-off; the robot must be armed.",
        input=m.TakeOff,
        output=m.Height,
        feedback=m.Height,
        examples=({"altitude": 10.0},),
        max_age=_GOAL,
    ),
)
_LAND = Definition(
    resource=Resource(
        name="action/land",
        description="Land where the robot is, and disarm.",
        output=m.Height,
        feedback=m.Height,
        max_age=_GOAL,
    ),
    required=False,  # an aeroplane lands only where an approach was planned
)
_RETURN_HOME = Definition(
    resource=Resource(
        name="action/return_home",
        description="Return to the place of take-off; what can land there lands and disarms.",
        output=m.Height,
        feedback=m.Height,
        max_age=_GOAL,
    ),
)
_RESET = Definition(
    resource=Resource(
        name="service/reset_system",
        description="Stop the robot and clear its faults; it is as after power-on, where it stands.",
    ),
)
_ENABLE = Definition(
    resource=Resource(
        name="service/enable",
        description="Give the motors torque.",
        energises=True,
    ),
    required=False,
)
_DISABLE = Definition(
    resource=Resource(
        name="service/disable",
        description="Take the torque off the motors.",
    ),
    required=False,
)

DRIVE = Profile(
    name="drive",
    version="1.0",
    description="Something that is driven by velocity and tells how fast it moves.",
    resources=(
        _VELOCITY,
        _CMD_VEL,
        structs.replace(_POSE, required=False),
        HOLD,
    ),
)
MOBILE = Profile(
    name="mobile",
    version="1.1",
    description="A robot that is driven by velocity or sent to a position.",
    includes=(DRIVE,),
    resources=(_POSE, _MOVE_TO, _SPEED_LIMIT),
)
AERIAL = Profile(
    name="aerial",
    version="1.1",
    description="An aircraft: what a mobile robot has, and take-off, landing where it can, and return.",
    # Not `includes=(MOBILE,)`: an aeroplane cannot fly a velocity, and a copter claims both.
    resources=(
        _POSE,
        _VELOCITY,
        structs.replace(_CMD_VEL, required=False),
        _MOVE_TO,
        _SPEED_LIMIT,
        HOLD,
        _ARMED,
        _ATTITUDE,
        _GNSS,
        _ARM,
        _DISARM,
        _TAKEOFF,
        _LAND,
        _RETURN_HOME,
    ),
)
POWER = Profile(
    name="power",
    version="1.0",
    description="A robot that is reset, and whose motors can be switched on and off.",
    resources=(_RESET, _ENABLE, _DISABLE),
)
