"""The messages that one peer is sent regularly, and their rates."""

from __future__ import annotations

from typing import Any

from rcp_mavlink_sim.vehicle import Vehicle
from rcp_mavlink_sim.wire import mav

__all__ = ["Streams"]

_M = mav
_GROUPS: dict[int, tuple[int, ...]] = {
    1: (_M.MAVLINK_MSG_ID_RAW_IMU, _M.MAVLINK_MSG_ID_SCALED_IMU2, _M.MAVLINK_MSG_ID_SCALED_PRESSURE),
    2: (_M.MAVLINK_MSG_ID_SYS_STATUS, _M.MAVLINK_MSG_ID_POWER_STATUS, _M.MAVLINK_MSG_ID_MISSION_CURRENT,
        _M.MAVLINK_MSG_ID_GPS_RAW_INT, _M.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT, _M.MAVLINK_MSG_ID_FENCE_STATUS),
    3: (_M.MAVLINK_MSG_ID_RC_CHANNELS, _M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW),
    6: (_M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    10: (_M.MAVLINK_MSG_ID_ATTITUDE,),
    11: (_M.MAVLINK_MSG_ID_VFR_HUD,),
    12: (_M.MAVLINK_MSG_ID_BATTERY_STATUS, _M.MAVLINK_MSG_ID_EKF_STATUS_REPORT, _M.MAVLINK_MSG_ID_VIBRATION,
         _M.MAVLINK_MSG_ID_SYSTEM_TIME, _M.MAVLINK_MSG_ID_TERRAIN_REPORT, _M.MAVLINK_MSG_ID_TERRAIN_REQUEST, _M.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS),
}  # fmt: skip
_FASTEST = 0.0025  # s


class Streams:
    """Intervals by message, in real seconds; only heartbeats are sent without a request."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._intervals: dict[int, float] = dict(vehicle.usual)
        self._due: dict[int, float] = {}
        if vehicle.options.streaming:
            for group in _GROUPS:
                self.group(group, 4.0, on=True)

    def every(self, number: int, microseconds: float) -> bool:
        """Handle SET_MESSAGE_INTERVAL; return whether the message exists."""
        if number not in self._vehicle.makers:
            return False
        if microseconds == 0:
            self._set(number, self._vehicle.usual.get(number))
        else:
            self._set(number, max(_FASTEST, microseconds / 1e6) if microseconds > 0 else None)
        return True

    def interval(self, number: int) -> int:
        """Return the interval as in MESSAGE_INTERVAL, µs; -1 is never, 0 unknown."""
        if number not in self._vehicle.makers:
            return 0
        seconds = self._intervals.get(number)
        return -1 if seconds is None else round(seconds * 1e6)

    def group(self, number: int, rate: float, *, on: bool) -> None:
        """Handle REQUEST_DATA_STREAM."""
        numbers = _GROUPS.get(number, ())
        if number == 0:
            numbers = tuple(n for group in _GROUPS.values() for n in group)
        for message in self._vehicle.makers.keys() & set(numbers):
            self._set(message, 1 / rate if on and rate > 0 else None)

    def _set(self, number: int, seconds: float | None) -> None:
        if seconds is None:
            self._intervals.pop(number, None)
            self._due.pop(number, None)
        else:
            self._intervals[number] = seconds

    def due(self, wall: float) -> list[Any]:
        """Build the messages that are due."""
        found: list[Any] = []
        for number, seconds in self._intervals.items():
            due = self._due.get(number, 0.0)
            if wall < due:
                continue
            self._due[number] = due + seconds if wall - due < seconds else wall + seconds
            found += self._vehicle.measure(number)
        return found
