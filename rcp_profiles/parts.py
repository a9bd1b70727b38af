"""The profiles of parts that a robot has: `arm`, `gripper`, `battery`, `camera`, `lidar`."""

from __future__ import annotations

from rcp_profiles import messages as m
from rcp_profiles.moving import HOLD
from rcp_profiles.profile import Definition, Profile
from rcp_protocol.model import Resource
from rcp_protocol.types import LaserScan, PoseStamped

__all__ = ["ARM", "BATTERY", "CAMERA", "GRIPPER", "LIDAR"]

_GOAL = 30.0  # s, age at which a goal is refused
_POINTS = [
    {"time": 1.0, "positions": {"shoulder": 0.2, "elbow": -0.1}},
    {"time": 2.0, "positions": {"shoulder": 0.4, "elbow": 0.0}},
]

ARM = Profile(
    name="arm",
    version="1.0",
    description="Joints that move together, by name.",
    resources=(
        Definition(
            resource=Resource(
                name="sensor/joint_states",
                description="Position and velocity of each joint, counted as in the robot's description.",
                value=m.JointStates,
                examples=({"name": ["shoulder"], "position": [0.2], "velocity": [0.0]},),
            ),
        ),
        Definition(
            resource=Resource(
                name="action/move_joints",
                description="Move joints together to positions; completed when all are there.",
                input=m.MoveJoints,
                output=m.JointsMoved,
                feedback=m.MoveJointsFeedback,
                examples=({"positions": {"shoulder": 0.2}, "speed": 0.5},),
                max_age=_GOAL,
            ),
        ),
        Definition(
            resource=Resource(
                name="action/follow_trajectory",
                description="Move joints through waypoints, at each at its time; completed at the last.",
                input=m.FollowTrajectory,
                output=m.JointsMoved,
                feedback=m.TrajectoryFeedback,
                examples=({"points": _POINTS},),
                max_age=_GOAL,
            ),
        ),
        HOLD,
        Definition(
            resource=Resource(
                name="sensor/tool_pose",
                description="Pose of the tool, in the frame that `frame_id` names.",
                value=PoseStamped,
                examples=({"position": {"x": 0.4, "y": 0.0, "z": 0.3}, "frame_id": "base_link"},),
            ),
            frame="base_link",
            required=False,
        ),
        Definition(
            resource=Resource(
                name="action/move_tool",
                description="Move the tool to a pose, by inverse kinematics; completed when it is there.",
                input=m.MoveTool,
                output=m.MoveResult,
                feedback=m.MoveFeedback,
                examples=({"position": {"x": 0.4, "y": 0.1, "z": 0.3}},),
                max_age=_GOAL,
            ),
            frame="base_link",
            required=False,
        ),
    ),
)
GRIPPER = Profile(
    name="gripper",
    version="1.0",
    description="Fingers that open and close.",
    resources=(
        Definition(
            resource=Resource(
                name="sensor/gripper",
                description="How far the gripper is open, and whether it holds something.",
                value=m.GripperState,
                examples=({"width": 0.04, "holding": False},),
            ),
        ),
        Definition(
            resource=Resource(
                name="action/move_gripper",
                description="Open or close the gripper; completed at the width, or when it holds something.",
                input=m.MoveGripper,
                output=m.GripperState,
                feedback=m.GripperState,
                examples=({"width": 0.02}, {"width": 0.0, "force": 5.0}),
                max_age=_GOAL,
            ),
        ),
        HOLD,
    ),
)
BATTERY = Profile(
    name="battery",
    version="1.0",
    description="A battery that tells its charge.",
    resources=(
        Definition(
            resource=Resource(
                name="sensor/battery",
                description="Remaining charge, voltage and current of the battery.",
                value=m.BatteryState,
                examples=({"percentage": 0.81, "voltage": 12.1, "current": -0.7},),
            ),
        ),
    ),
)
CAMERA = Profile(
    name="camera",
    version="1.0",
    description="A camera.",
    resources=(
        Definition(
            resource=Resource(
                name="sensor/camera",
                description="Image of the camera, as a file; its first row is the upper one.",
                value=m.Image,
                examples=({"width": 160, "height": 120, "data": "iVBORw0KGgo=", "format": "png"},),
            ),
            frame="camera",
        ),
    ),
)
LIDAR = Profile(
    name="lidar",
    version="1.0",
    description="A planar range finder.",
    resources=(
        Definition(
            resource=Resource(
                name="sensor/scan",
                description="One sweep of the range finder, counter-clockwise from `angle_min`; a beam without a return is Infinity.",
                value=LaserScan,
                examples=(
                    {
                        "angle_min": -1.57,
                        "angle_increment": 1.57,
                        "range_min": 0.05,
                        "range_max": 12.0,
                        "ranges": [4.2, "Infinity", 3.9],
                    },
                ),
            ),
            frame="laser",
        ),
    ),
)
