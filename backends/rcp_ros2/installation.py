"""Where ROS 2 comes from on this machine, for whoever has not got it."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

__all__ = ["install_advice"]

_HOME = Path("/opt/ros")
_EXTRA = "pip install 'rcp-gateway[ros2]'"


def install_advice(home: Path = _HOME) -> str:
    """Return what makes `rclpy` importable: an installation of ROS 2, or wheels where there are any."""
    setups = sorted(home.glob("*/setup.bash"))
    if setups:
        return (
            f"run `source {setups[-1]}` before rcpd, in the shell or the unit, with a Python of the "
            "version for which that ROS 2 was made"
        )
    wheels = sys.version_info[:2] == (3, 11) and sys.platform == "linux"
    if wheels and platform.machine() == "x86_64":
        return f"{_EXTRA}, or source an installation of ROS 2 before rcpd"
    return (
        "source an installation of ROS 2 before rcpd (`source /opt/ros/DISTRO/setup.bash`); "
        "wheels of it exist for Python 3.11 on x86-64 Linux alone"
    )
