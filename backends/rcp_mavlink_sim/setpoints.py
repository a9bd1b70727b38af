"""Set-points in GUIDED: position, velocity, attitude; unsupported ones are ignored."""

from __future__ import annotations

import math
from typing import Any

from rcp_mavlink.geo import shifted
from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["take"]

_QUICKEST = 1e3  # m/s
_NO_PLACE, _NO_VELOCITY = 0b111, 0b111000
_NO_YAW, _NO_YAW_RATE = 1 << 10, 1 << 11
_NO_RATES, _NO_THRUST, _NO_ATTITUDE = 0b111, 1 << 6, 1 << 7
_UNIT = 1e-3  # tolerance of a quaternion's norm
_THRUST_AS_THRUST = 1 << 3  # bit of GUID_OPTIONS
_BODY_FRAMES = frozenset({8, 9, 12})
_OFFSET_FRAMES = frozenset({7, 9})


def take(vehicle: Vehicle, message: Any) -> None:
    """Handle a set-point; there is no reply in any case."""
    grounded = vehicle.body.landed and vehicle.kind.flies
    if vehicle.flight.mode is not vehicle.flight.led or not vehicle.armed or grounded:
        return
    if message.get_type() == "SET_ATTITUDE_TARGET":
        if vehicle.kind.name == "copter":
            _attitude(vehicle, message)
    else:
        _place_or_velocity(vehicle, message)


def _attitude(vehicle: Vehicle, message: Any) -> None:
    """Hold an attitude; its yaw is absolute, and thrust is a climb rate."""
    w, x, y, z = message.q
    mask, thrust = message.type_mask, message.thrust
    rates = mask & _NO_RATES
    if mask & (_NO_THRUST | _NO_ATTITUDE) or rates not in (0, _NO_RATES):
        return
    if not math.isfinite(thrust) or not abs(math.hypot(w, x, y, z) - 1) <= _UNIT:
        return
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    most = math.radians(vehicle.params["ANGLE_MAX"] / 100)
    lean = (max(-most, min(most, roll)), max(-most, min(most, pitch)))
    vehicle.flight.follow("attitude")
    pilot, limits, thrust = vehicle.pilot, vehicle.pilot.limits, max(0.0, min(1.0, thrust))
    pilot.yaw, pilot.yaw_rate, pilot.faces_travel = yaw, 0.0, False
    pilot.place = None
    if int(vehicle.params["GUID_OPTIONS"]) & _THRUST_AS_THRUST:
        pilot.attitude, pilot.lean = (*lean, thrust), None
        return
    climb = 2 * (thrust - 0.5) * (limits.up if thrust > 0.5 else limits.down)
    pilot.attitude, pilot.lean = None, lean
    pilot.depth, pilot.sinking = None, -climb


def _place_or_velocity(vehicle: Vehicle, message: Any) -> None:
    mask, pilot = message.type_mask, vehicle.pilot
    place = mask & _NO_PLACE == 0
    velocity = mask & _NO_VELOCITY == 0
    if place:
        target = _target(vehicle, message)
        if target is None:
            return
        n, e, depth = target
        fenced = vehicle.params["FENCE_ENABLE"]
        if fenced and vehicle.fence.crossed(shifted(n, e, vehicle.origin[:2]), -depth):
            return
        vehicle.flight.aim((n, e), depth)
    elif not velocity:
        return
    if velocity and vehicle.kind.name != "plane":
        vn, ve = _turned(vehicle, message.coordinate_frame, message.vx, message.vy)
        vd = message.vz
        if not all(abs(part) <= _QUICKEST for part in (vn, ve, vd)):
            return
        pilot.attitude = pilot.lean = None
        pilot.velocity = (vn, ve)
        if not place:
            vehicle.flight.follow("velocity")
            pilot.place, pilot.depth, pilot.sinking = None, None, vd
            pilot.faces_travel = vehicle.flight.faces_travel
    if not (math.isfinite(message.yaw) and math.isfinite(message.yaw_rate)):
        return
    if not mask & _NO_YAW:
        pilot.yaw, pilot.yaw_rate, pilot.faces_travel = message.yaw, 0.0, False
    elif not mask & _NO_YAW_RATE:
        pilot.yaw_rate, pilot.faces_travel = message.yaw_rate, False


def _turned(vehicle: Vehicle, frame: int, x: float, y: float) -> tuple[float, float]:
    if frame not in _BODY_FRAMES:
        return x, y
    s, c = math.sin(vehicle.body.yaw), math.cos(vehicle.body.yaw)
    return x * c - y * s, x * s + y * c


def _target(vehicle: Vehicle, message: Any) -> tuple[float, float, float] | None:
    frame, body = message.coordinate_frame, vehicle.body
    if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
        lat, lon = message.lat_int / 1e7, message.lon_int / 1e7
        if not (-90 <= lat <= 90 and -180 <= lon <= 180) or not math.isfinite(message.alt):
            return None
        relative = frame in (3, 6)
        n, e = vehicle.place_of(lat, lon)
        return n, e, -(message.alt if relative else message.alt - vehicle.origin[2])
    if not all(map(math.isfinite, (message.x, message.y, message.z))):
        return None
    if frame in _OFFSET_FRAMES or frame in _BODY_FRAMES:
        x, y = _turned(vehicle, frame, message.x, message.y)
        return body.n + x, body.e + y, body.d + message.z
    north, east, down = vehicle.from_origin()
    return message.x + north, message.y + east, message.z + down
