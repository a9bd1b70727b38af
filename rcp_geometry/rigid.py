"""Rigid transforms: a rotation and a translation, in three dimensions."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["IDENTITY", "Quat", "Rigid", "Vec", "about_z"]

Vec = tuple[float, float, float]
Quat = tuple[float, float, float, float]
"""A unit quaternion: x, y, z, w."""


class Rigid(NamedTuple):
    """The pose of a frame in another one, m: it takes points of the former to the latter."""

    position: Vec
    rotation: Quat

    def point(self, at: Vec) -> Vec:
        """Return a point of the inner frame in the outer one."""
        x, y, z = self.vector(at)
        px, py, pz = self.position
        return px + x, py + y, pz + z

    def vector(self, along: Vec) -> Vec:
        """Return a direction of the inner frame in the outer one."""
        x, y, z = along
        qx, qy, qz, qw = self.rotation
        tx, ty, tz = 2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)
        return (
            x + qw * tx + qy * tz - qz * ty,
            y + qw * ty + qz * tx - qx * tz,
            z + qw * tz + qx * ty - qy * tx,
        )

    def turn(self, orientation: Quat) -> Quat:
        """Return an orientation in the inner frame in the outer one."""
        return _unit(_product(self.rotation, orientation))

    def join(self, inner: Rigid) -> Rigid:
        """Return the pose of `inner`, which is given in this frame, in the outer one."""
        return Rigid(self.point(inner.position), self.turn(inner.rotation))

    @property
    def inverse(self) -> Rigid:
        """The pose of the outer frame in the inner one."""
        x, y, z, w = self.rotation
        back = Rigid((0.0, 0.0, 0.0), (-x, -y, -z, w))
        px, py, pz = back.vector(self.position)
        return back._replace(position=(-px, -py, -pz))

    def yaw(self, yaw: float) -> float:
        """Return an angle about z of the inner frame as one about z of the outer frame."""
        x, y, _ = self.vector((math.cos(yaw), math.sin(yaw), 0.0))
        return math.atan2(y, x)


def about_z(yaw: float) -> Quat:
    """Return the rotation by an angle about z, rad."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _product(a: Quat, b: Quat) -> Quat:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _unit(q: Quat) -> Quat:
    """Keep rounding from adding up; a robot's quaternion may be a little off as well."""
    norm = math.hypot(*q)
    x, y, z, w = q
    return (x / norm, y / norm, z / norm, w / norm) if norm > 0 else q


IDENTITY = Rigid((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
