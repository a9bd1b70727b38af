"""ROS 2 robots: topics, services, actions and parameters as resources, by map or by pattern.

Importing this costs nothing; rclpy itself is imported when a backend is opened, in its own thread.
"""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind
from rcp_ros2.backend import Ros2Backend, open_ros2
from rcp_ros2.config import Mapping, Qos, Ros2Config
from rcp_ros2.environment import lacking
from rcp_ros2.installation import install_advice
from rcp_ros2.topics import PROFILE

__all__ = ["PROFILE", "Mapping", "Qos", "Ros2Backend", "Ros2Config", "open_ros2", "rcp_backends"]


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Register the ROS 2 backend."""
    kind = BackendKind(
        "ros2",
        Ros2Config,
        open_ros2,
        "ROS 2 robots.",
        needs=("rclpy", "rcl_interfaces", "numpy"),
        lacks=lacking,
        wants=("simplejpeg",),  # JPEGs of raw images
        remedy=install_advice(),
    )
    return [kind]
