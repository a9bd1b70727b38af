"""The names that ROS 2 robots have in common, and what of a profile each of them is."""

from __future__ import annotations

from typing import Literal, NamedTuple

__all__ = [
    "CONVENTIONS",
    "JOINT_TRAJECTORY",
    "LIMITS",
    "SPEED_LIMIT",
    "Convention",
    "may_be",
    "rank_of",
]

Noun = Literal["topic", "service", "action"]

ODOMETRY = "nav_msgs/msg/Odometry"
JOINT_TRAJECTORY = "control_msgs/action/FollowJointTrajectory"
_ODOM = ("odom", "odometry")
_TRAJECTORY = ("*/follow_joint_trajectory",)


class Convention(NamedTuple):
    """A name and the types that are one resource of a profile."""

    resource: str
    noun: Noun
    names: tuple[str, ...]
    """Names below the robot's namespace, the usual one first; one that begins with `*/` is below a part
    of the robot as well, and each part has one."""
    types: tuple[str, ...]


CONVENTIONS = (
    Convention("sensor/pose", "topic", _ODOM, (ODOMETRY,)),
    Convention("sensor/velocity", "topic", _ODOM, (ODOMETRY,)),
    Convention(
        "actuator/cmd_vel",
        "topic",
        ("cmd_vel",),
        ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    ),
    Convention(
        "action/move_to", "action", ("navigate_to_pose",), ("nav2_msgs/action/NavigateToPose",)
    ),
    Convention("service/reset_system", "service", ("reset_system",), ("std_srvs/srv/Trigger",)),
    Convention(
        "sensor/scan",
        "topic",
        ("scan", "base_scan", "laser_scan"),
        ("sensor_msgs/msg/LaserScan",),
    ),
    Convention(
        "sensor/battery",
        "topic",
        ("battery_state", "battery_status", "battery"),
        ("sensor_msgs/msg/BatteryState",),
    ),
    Convention("sensor/joint_states", "topic", ("joint_states",), ("sensor_msgs/msg/JointState",)),
    Convention("action/move_joints", "action", _TRAJECTORY, (JOINT_TRAJECTORY,)),
    Convention("action/follow_trajectory", "action", _TRAJECTORY, (JOINT_TRAJECTORY,)),
    Convention(
        "sensor/camera",
        "topic",
        ("*/image_raw/compressed",),
        ("sensor_msgs/msg/CompressedImage",),
    ),
)

SPEED_LIMIT = "param/speed_limit"
LIMIT_TOPIC = ("/speed_limit", "nav2_msgs/msg/SpeedLimit")
"""The name below the robot's namespace and the type of the topic on which Nav2 takes a limit."""
LIMITS = (
    "speed_limit",
    "FollowPath.max_vel_x",
    "FollowPath.desired_linear_vel",
    "FollowPath.vx_max",
)
"""Parameters that are a robot's speed limit, the usual one first: a base's own, and those of Nav2's DWB, pure
pursuit and MPPI."""


def may_be(resource: str) -> bool:
    """Return whether a mapping can be a profile's resource."""
    return resource == SPEED_LIMIT or any(c.resource == resource for c in CONVENTIONS)


def rank_of(convention: Convention, rest: str) -> int | None:
    """Return the rank of a name below its robot's namespace, 0 for the usual one; None: another name."""
    for rank, name in enumerate(convention.names):
        if rest == f"/{name.removeprefix('*/')}":
            return rank
        if name.startswith("*/") and rest.endswith(name[1:]):
            return rank
    return None
