"""The camera mount: a gimbal with a limited rate, and a trigger. Angles are in degrees."""

from __future__ import annotations

import math

from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["Mount", "quaternion"]

_QUICKEST = 90.0  # deg/s
_LEVEL = mav.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mav.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_YAW_LOCK = mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK
_IN_VEHICLE = mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME


class Mount:
    """Direction of the camera, and its pictures."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
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
        p = self._vehicle.params
        self._wanted = (roll, _within(pitch, p["MNT1_PITCH_MIN"], p["MNT1_PITCH_MAX"]), yaw)
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
        p = self._vehicle.params
        yaw = _within(math.remainder(yaw, 360.0), p["MNT1_YAW_MIN"], p["MNT1_YAW_MAX"])
        self.roll += _within(roll - self.roll, -most, most)
        self.pitch += _within(pitch - self.pitch, -most, most)
        self.yaw += _within(yaw - self.yaw, -most, most)

    def _look_at(self, region: tuple[float, float, float]) -> None:
        v, p = self._vehicle, self._vehicle.params
        north, east = v.place_of(*region[:2])
        north, east = north - v.body.n, east - v.body.e
        below = v.origin[2] - v.body.d - region[2]
        pitch = math.degrees(math.atan2(-below, math.hypot(north, east)))
        yaw = math.degrees(math.atan2(east, north))
        self._wanted = (0.0, _within(pitch, p["MNT1_PITCH_MIN"], p["MNT1_PITCH_MAX"]), yaw)
        self._locked = True

    def look_ahead(self) -> None:
        """Keep no place in view any more, and turn ahead."""
        self.region, self._wanted, self._locked = None, (0.0, 0.0, 0.0), False

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
