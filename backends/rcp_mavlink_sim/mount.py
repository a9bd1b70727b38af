"""Camera mounts: gimbals with a limited rate, and a trigger. Angles are in degrees."""

from __future__ import annotations

import math
from typing import Literal

from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["Mount", "quaternion"]

_QUICKEST = 90.0  # deg/s
_LEVEL = mav.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mav.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_YAW_LOCK = mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK
_IN_VEHICLE = mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME


class Mount:
    """Direction of the camera, and its pictures."""

    def __init__(self, vehicle: VehicleState, number: int = 1) -> None:
        self._vehicle = vehicle
        self.number = number
        """Its device id: 1 or 2."""
        self.roll = self.pitch = self.yaw = 0.0
        """Yaw relative to the vehicle's heading."""
        self._wanted = (0.0, 0.0, 0.0)
        self._locked = False
        self.control: tuple[int, int] = (0, 0)
        """System and component that have control."""
        self.photos = 0
        self.region: tuple[float, float, float] | None = None
        """Latitude, longitude (deg) and height above the sea (m) that it keeps in view."""

    def turn(self, pitch: float, yaw: float, *, roll: float = 0.0, locked: bool = False) -> bool:
        """Turn to angles, with yaw from north if `locked`; return whether they are valid."""
        if not all(map(math.isfinite, (pitch, yaw, roll))):
            return False
        self.region = None
        self._wanted = (roll, _within(pitch, *self.range("PITCH")), yaw)
        self._locked = locked
        return True

    def step(self, seconds: float) -> None:
        """Continue to turn."""
        if self.region is not None:
            self._look_at(self.region)
        most = _QUICKEST * seconds
        roll, pitch, yaw = self._wanted
        if self._locked:
            yaw -= math.degrees(self._vehicle.body.yaw)
        yaw = _within(math.remainder(yaw, 360.0), *self.range("YAW"))
        self.roll += _within(roll - self.roll, -most, most)
        self.pitch += _within(pitch - self.pitch, -most, most)
        self.yaw += _within(yaw - self.yaw, -most, most)

    def _look_at(self, region: tuple[float, float, float]) -> None:
        v = self._vehicle
        north, east = v.place_of(*region[:2])
        north, east = north - v.body.n, east - v.body.e
        below = v.origin[2] - v.body.d - region[2]
        pitch = math.degrees(math.atan2(-below, math.hypot(north, east)))
        yaw = math.degrees(math.atan2(east, north))
        self._wanted = (0.0, _within(pitch, *self.range("PITCH")), yaw)
        self._locked = True

    def look_ahead(self) -> None:
        """Keep no place in view any more, and turn ahead."""
        self.region, self._wanted, self._locked = None, (0.0, 0.0, 0.0), False

    @property
    def fitted(self) -> bool:
        """Whether it is there (`MNTn_TYPE`)."""
        return bool(self._vehicle.params[f"MNT{self.number}_TYPE"])

    def range(self, axis: Literal["PITCH", "YAW"]) -> tuple[float, float]:
        """Return the least and the largest angle around an axis."""
        p, name = self._vehicle.params, f"MNT{self.number}_{axis}"
        return p[f"{name}_MIN"], p[f"{name}_MAX"]

    def flags(self) -> int:
        """Return the GIMBAL_DEVICE_FLAGS in effect; yaw is reported relative to the vehicle."""
        return _LEVEL | _IN_VEHICLE | (_YAW_LOCK if self._locked else 0)

    def shoot(self) -> None:
        """Take a picture and report it to everybody."""
        self.photos += 1
        v = self._vehicle
        lat, lon = (round(angle * 1e7) for angle in v.geographic())
        b = v.body
        v.broadcast(
            mav.MAVLink_camera_feedback_message(
                round(v.time * 1e6), 1, 0, self.photos, lat, lon, v.origin[2] - b.d, -b.d,
                math.degrees(b.roll), math.degrees(b.pitch), math.degrees(b.yaw), 50.0, 0, self.photos,
            )
        )  # fmt: skip


def _within(value: float, least: float, most: float) -> float:
    return min(most, max(least, value))


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return w, x, y, z."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
