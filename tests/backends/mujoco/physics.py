"""A robot without its thread: the tests step it, and no test waits for time to pass."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rcp_mujoco import MujocoConfig
from rcp_mujoco.robot import Robot

__all__ = ["ELBOW", "PUCK", "model_of", "robot_of", "run", "until"]

ELBOW = """
<robot name="elbow">
  <link name="base_link"/>
  <link name="forearm">
    <inertial>
      <origin xyz="0 0 0.1"/><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="base_link"/><child link="forearm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="0.5" effort="20" velocity="2"/>
  </joint>
</robot>
"""
"""A URDF, which has joints and no actuators."""

PUCK = """
<mujoco>
  <worldbody>
    <body name="puck">
      <joint name="slide" type="slide" axis="1 0 0" range="-5 5" limited="true"/>
      <geom size="0.1" mass="1"/>
      <site name="puck"/>
      <body name="far" pos="0 0 2"><geom size="0.1"/></body>
    </body>
    <body name="ball" pos="0 3 0"><freejoint/><geom size="0.1"/></body>
  </worldbody>
  <actuator>
    <motor name="push force" joint="slide" ctrlrange="-20 20"/>
  </actuator>
  <sensor>
    <jointpos name="place" joint="slide"/>
    <velocimeter name="speed" site="puck"/>
    <touch name="bumper" site="puck"/>
    <clock name="clock"/>
  </sensor>
</mujoco>
"""
"""An MJCF with a motor that coasts, next to a ball that falls for ever."""


def model_of(text: str, folder: Path) -> str:
    """Write a model to a file; return its path."""
    file = folder / ("model.urdf" if "<robot" in text else "model.xml")
    file.write_text(text, encoding="utf-8")
    return str(file)


def robot_of(model: str = "rover", **config: Any) -> Robot:
    """Make a robot."""
    return Robot(MujocoConfig(model=model, **config))


def run(robot: Robot, seconds: float) -> None:
    """Let simulated time pass."""
    for _ in range(round(seconds / robot.simulation.dt)):
        robot.simulation.step()


def until(robot: Robot, holds: Callable[[], bool], within: float = 60.0) -> float:
    """Step until something holds; return after how many seconds."""
    for count in itertools.count():
        seconds = count * robot.simulation.dt
        if holds():
            return seconds
        assert seconds < within, f"not within {within} s"
        robot.simulation.step()
    raise AssertionError
