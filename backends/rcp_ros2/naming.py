"""Paths of names in the graph: robots by namespace, and conventional names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

from rcp_ros2.config import Ros2Config
from rcp_ros2.names import resource_name

__all__ = ["COMMANDS", "Naming", "Nice", "nice"]

COMMANDS = {
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "ackermann_msgs/msg/AckermannDrive",
    "ackermann_msgs/msg/AckermannDriveStamped",
    "trajectory_msgs/msg/JointTrajectory",
}
"""Types of topics that are commands, even if other nodes publish on them too."""


class Nice(NamedTuple):
    """The conventional path of a topic or action of a well-known type and name."""

    ends: tuple[str, ...]
    """Suffixes of the ROS name, in whole segments."""
    name: str
    """The conventional name."""
    field: str | None = None
    """Select only this field; the whole message keeps its own path."""


_IMAGE = Nice(("image_raw",), "image")
_VELOCITY = Nice(("cmd_vel",), "velocity")
_ODOM = ("odom", "odometry")
_TABLE: dict[tuple[str, str], tuple[Nice, ...]] = {
    ("sensor", "nav_msgs/msg/Odometry"): (
        Nice(_ODOM, "pose", "pose.pose"),
        Nice(_ODOM, "velocity", "twist.twist"),
    ),
    ("sensor", "sensor_msgs/msg/BatteryState"): (
        Nice(("battery_state", "battery_status", "battery"), "battery"),
    ),
    ("sensor", "sensor_msgs/msg/Image"): (_IMAGE,),
    ("sensor", "sensor_msgs/msg/Imu"): (Nice(("imu/data", "imu"), "imu"),),
    ("sensor", "sensor_msgs/msg/JointState"): (Nice(("joint_states",), "joints"),),
    ("sensor", "sensor_msgs/msg/LaserScan"): (Nice(("scan", "base_scan", "laser_scan"), "scan"),),
    ("sensor", "sensor_msgs/msg/NavSatFix"): (
        Nice(("gps/fix", "navsat/fix", "fix", "navsat"), "gps"),
    ),
    ("sensor", "sensor_msgs/msg/PointCloud2"): (
        Nice(("points_raw", "points2", "velodyne_points"), "points"),
    ),
    ("actuator", "geometry_msgs/msg/Twist"): (_VELOCITY,),
    ("actuator", "geometry_msgs/msg/TwistStamped"): (_VELOCITY,),
    ("actuator", "geometry_msgs/msg/PoseStamped"): (Nice(("goal_pose",), "goal"),),
    ("action", "nav2_msgs/action/NavigateToPose"): (Nice(("navigate_to_pose",), "move_to"),),
}


def nice(branch: str, name: str, type_: str) -> Iterable[tuple[str, str | None]]:
    """Return the conventional names of a ROS name, each with the selected field."""
    for one in _TABLE.get((branch, type_), ()):
        end = next((e for e in one.ends if name.endswith(f"/{e}")), None)
        if end is not None:
            yield name.removesuffix(end) + one.name, one.field


class Naming:
    """The naming rules of a configuration."""

    def __init__(self, config: Ros2Config) -> None:
        self._root = config.namespace.rstrip("/")
        self._robots = [re.compile(_expression(pattern)) for pattern in config.robots]
        self.split = lru_cache(8192)(self._split)

    def _split(self, name: str) -> tuple[str | None, str, str]:
        """Split a name into the robot, its namespace, and the rest."""
        for pattern in self._robots:
            found = pattern.match(name)
            if found is not None:
                space = found[0]
                robot = "_".join(found.groups()) or space.rpartition("/")[2]
                return robot, space, name[len(space) :]
        if self._root and name.startswith(self._root + "/"):
            return None, self._root, name[len(self._root) :]
        return None, "", name

    def path(
        self, branch: str, name: str, before: tuple[str, ...] = (), after: tuple[str, ...] = ()
    ) -> str:
        """Return the path of a ROS name, with segments before and after it."""
        robot, _, rest = self.split(name)
        return resource_name(branch, robot or "", *before, rest, *after)

    def below(self, path: str, robot: str | None) -> str:
        """Return one robot's path for a mapping that applies to each robot."""
        branch, _, rest = path.partition("/")
        return f"{branch}/{robot}/{rest}" if robot else path


def _expression(pattern: str) -> str:
    parts = (re.escape(s).replace(r"\*", "([^/]*)") for s in pattern.strip("/").split("/"))
    return "".join(f"/{part}" for part in parts) + r"(?=/|\Z)"
