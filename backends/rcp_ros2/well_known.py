"""Interfaces that robots have in common and no package index has: their fields, version by version.

Nodes tell the types of their topics, but not of their services and actions: a description is only given
to whoever knows its hash, and the graph has none of those. It has the hashes of their messages,
which show the version.
"""

from __future__ import annotations

__all__ = ["VERSIONS"]

_POINT = "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
_LIMITS = "float64 position\nfloat64 velocity\nfloat64 acceleration\n"
_GOING = """\
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""
_GO = "geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n"
_FOLLOW = """\
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
"""
VERSIONS: dict[str, tuple[str, ...]] = {
    "nav2_msgs/action/NavigateToPose": (
        f"{_GO}uint16 error_code\nstring error_msg\n---\n{_GOING}",  # Kilted
        f"{_GO}uint16 error_code\n---\n{_GOING}",  # Iron, Jazzy
        f"{_GO}std_msgs/Empty result\n---\n{_GOING}",  # Humble
    ),
    "nav2_msgs/msg/SpeedLimit": ("std_msgs/Header header\nbool percentage\nfloat64 speed_limit\n",),
    "control_msgs/action/FollowJointTrajectory": (_FOLLOW,),
    "control_msgs/msg/JointTolerance": (f"string name\n{_LIMITS}",),
    "control_msgs/msg/JointComponentTolerance": (
        f"string joint_name\nuint16 component\n{_LIMITS}",
    ),
    "tf2_msgs/msg/TFMessage": ("geometry_msgs/TransformStamped[] transforms\n",),
    "trajectory_msgs/msg/JointTrajectoryPoint": (
        f"{_POINT}builtin_interfaces/Duration time_from_start\n",
    ),
    "trajectory_msgs/msg/JointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points\n",
    ),
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint": (
        """\
geometry_msgs/Transform[] transforms
geometry_msgs/Twist[] velocities
geometry_msgs/Twist[] accelerations
builtin_interfaces/Duration time_from_start
""",
    ),
    "trajectory_msgs/msg/MultiDOFJointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\nMultiDOFJointTrajectoryPoint[] points\n",
    ),
}
"""Text by the name of the type, newest first; those without a message are in every distribution."""
