"""The rover's URDF, its wheel joints and its frames."""

from __future__ import annotations

import math

from rcp_kernel.types import Point
from rcp_sim.camera import EYE
from rcp_sim.rover import Rover
from rcp_sim.sensors import Wheels, heading
from rcp_sim.spatial import JointState, Rigid, Transforms, TransformStamped, stamped

__all__ = ["DESCRIPTION", "joints", "transforms"]

_LASER = 0.25  # m, height of the laser above the floor
_WHEEL = 0.08  # m, radius
_TRACK = 0.36  # m between the wheels
_FIXED = (("laser", _LASER), ("camera", EYE))

_WHEELS = "".join(
    f"""
  <link name="{side}_wheel">
    <visual>
      <origin rpy="1.570796 0 0"/>
      <geometry><cylinder radius="{_WHEEL}" length="0.05"/></geometry>
      <material name="dark"/>
    </visual>
    <visual>
      <geometry><box size="{_WHEEL * 1.7} 0.056 0.03"/></geometry>
      <material name="light"/>
    </visual>
  </link>
  <joint name="{side}_wheel_joint" type="continuous">
    <origin xyz="0 {y} {_WHEEL}"/>
    <axis xyz="0 1 0"/>
    <parent link="base_link"/>
    <child link="{side}_wheel"/>
  </joint>"""
    for side, y in (("left", _TRACK / 2), ("right", -_TRACK / 2))
)
DESCRIPTION = f"""<?xml version="1.0"?>
<robot name="rover">
  <material name="shell"><color rgba="0.16 0.44 0.78 1"/></material>
  <material name="dark"><color rgba="0.12 0.13 0.15 1"/></material>
  <material name="light"><color rgba="0.82 0.84 0.86 1"/></material>
  <material name="lens"><color rgba="0.95 0.6 0.15 1"/></material>
  <link name="base_link">
    <visual>
      <origin xyz="0 0 0.13"/>
      <geometry><cylinder radius="0.22" length="0.12"/></geometry>
      <material name="shell"/>
    </visual>
    <visual>
      <origin xyz="0 0 0.2"/>
      <geometry><cylinder radius="0.19" length="0.02"/></geometry>
      <material name="light"/>
    </visual>
    <visual>
      <origin xyz="0.17 0 0.13"/>
      <geometry><box size="0.12 0.2 0.07"/></geometry>
      <material name="dark"/>
    </visual>
    <visual>
      <origin xyz="-0.17 0 0.03"/>
      <geometry><sphere radius="0.03"/></geometry>
      <material name="light"/>
    </visual>
  </link>{_WHEELS}
  <link name="laser">
    <visual>
      <geometry><cylinder radius="0.05" length="0.06"/></geometry>
      <material name="dark"/>
    </visual>
    <visual>
      <origin xyz="-0.03 0 0.075"/>
      <geometry><box size="0.02 0.02 0.15"/></geometry>
      <material name="light"/>
    </visual>
  </link>
  <joint name="laser_joint" type="fixed">
    <origin xyz="0 0 {_LASER}"/>
    <parent link="base_link"/>
    <child link="laser"/>
  </joint>
  <link name="camera">
    <visual>
      <origin xyz="-0.02 0 0"/>
      <geometry><box size="0.04 0.14 0.04"/></geometry>
      <material name="dark"/>
    </visual>
    <visual>
      <origin xyz="0.005 0 0" rpy="0 1.570796 0"/>
      <geometry><cylinder radius="0.014" length="0.02"/></geometry>
      <material name="lens"/>
    </visual>
  </link>
  <joint name="camera_joint" type="fixed">
    <origin xyz="0 0 {EYE}"/>
    <parent link="base_link"/>
    <child link="camera"/>
  </joint>
</robot>
"""
"""URDF, built from boxes, cylinders and spheres."""


def joints(rover: Rover, now: int) -> JointState:
    """Return the angles and angular velocities of the wheels."""
    half = _TRACK / 2
    distance, turned, v, w = rover.path, rover.turned, rover.v, rover.w
    return JointState(
        stamped("", now),
        ["left_wheel_joint", "right_wheel_joint"],
        [(distance - turned * half) / _WHEEL, (distance + turned * half) / _WHEEL],
        [(v - w * half) / _WHEEL, (v + w * half) / _WHEEL],
    )


def transforms(rover: Rover, wheels: Wheels, now: int) -> Transforms:
    """Return the frame tree: `odom` from dead reckoning, `map` to `odom` its error."""
    turn = rover.yaw - wheels.yaw
    cosine, sine = math.cos(turn), math.sin(turn)
    x = rover.x - (cosine * wheels.x - sine * wheels.y)
    y = rover.y - (sine * wheels.x + cosine * wheels.y)
    fixed = stamped("base_link", now)
    return Transforms(
        [
            TransformStamped(stamped("map", now), "odom", Rigid(Point(x, y, 0.0), heading(turn))),
            TransformStamped(
                stamped("odom", now),
                "base_link",
                Rigid(Point(wheels.x, wheels.y, 0.0), heading(wheels.yaw)),
            ),
            *(
                TransformStamped(fixed, child, Rigid(Point(0.0, 0.0, height)))
                for child, height in _FIXED
            ),
        ]
    )
