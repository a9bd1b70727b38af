"""Messages of sensors, as the values that every robot of the gateway has for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

from rcp_can.dronecan.library import type_id
from rcp_profiles.messages import BatteryState, GnssFix

__all__ = ["SENSORS", "SensorKind", "battery", "gnss"]

_NO_FIX = 1  # and "time only": no position
_FIX_3D = 3
_CORRECTED = {1: "dgnss", 2: "rtk_float", 3: "dgnss"}  # by mode; RTK is told apart by its sub-mode
_RTK, _RTK_FIXED = 2, 1
_UTC = 2  # the time standard
_CHARGING = 2  # a flag
_DIAGONALS = {1: (0, 0), 6: (0, 1), 21: (0, 6), 36: (0, 7)}
"""Places of the variances of north and east, by the number of values of a covariance."""

_Fix = Literal["none", "2d", "3d", "dgnss", "rtk_float", "rtk_fixed"]


class SensorKind(NamedTuple):
    """A message that is a resource of a profile."""

    name: str
    profiles: tuple[str, ...]
    """The profiles that a robot with it has."""
    type_id: int
    value: type
    convert: Callable[[Any], Any]
    deadline: float
    """s without a message until it is stale."""
    description: str


def gnss(message: Any) -> GnssFix:
    """Return a fix; altitude is above mean sea level.

    :raises ValueError: the position is not on Earth.
    """
    latitude, longitude = message.latitude_deg_1e8 / 1e8, message.longitude_deg_1e8 / 1e8
    fixed = message.status > _NO_FIX
    if fixed and not (abs(latitude) <= 90 and abs(longitude) <= 180):
        raise ValueError(f"{latitude}, {longitude} is no position")
    accuracy = _accuracy(list(message.covariance)) if fixed else None
    return GnssFix(
        fix=_fix(message),
        latitude=latitude if fixed else None,
        longitude=longitude if fixed else None,
        altitude=message.height_msl_mm / 1e3 if message.status == _FIX_3D else None,
        satellites=message.sats_used,
        horizontal_accuracy=accuracy,
        timestamp=_time(message),
    )


def _fix(message: Any) -> _Fix:
    if message.status <= _NO_FIX:
        return "none"
    if message.mode == _RTK and message.sub_mode == _RTK_FIXED:
        return "rtk_fixed"
    corrected: Any = _CORRECTED.get(message.mode)
    return corrected or ("3d" if message.status == _FIX_3D else "2d")


def _accuracy(covariance: list[float]) -> float | None:
    places = _DIAGONALS.get(len(covariance))
    if places is None:
        return None
    variance = max(covariance[place] for place in places)
    return math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else None


def _time(message: Any) -> str | None:
    if message.gnss_time_standard != _UTC or not message.gnss_timestamp.usec:
        return None
    try:
        moment = datetime.fromtimestamp(message.gnss_timestamp.usec / 1e6, UTC)
    except (OverflowError, ValueError, OSError):
        return None
    return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")


def battery(message: Any) -> BatteryState:
    """Return the state of a battery, whose current DroneCAN counts positive while it discharges."""
    charge, voltage, current = message.state_of_charge_pct, message.voltage, message.current
    return BatteryState(
        percentage=charge / 100 if charge <= 100 else None,  # 127: unknown
        voltage=voltage if math.isfinite(voltage) and voltage >= 0 else None,
        current=-current if math.isfinite(current) else None,
        charging=bool(message.status_flags & _CHARGING),
    )


SENSORS = {
    "gnss": SensorKind(
        "sensor/gnss",
        (),  # only aircraft must have it
        type_id("equipment.gnss.Fix2"),
        GnssFix,
        gnss,
        1.0,
        "Position by satellites, on the WGS 84 ellipsoid.",
    ),
    "battery": SensorKind(
        "sensor/battery",
        ("battery",),
        type_id("equipment.power.BatteryInfo"),
        BatteryState,
        battery,
        15.0,  # it is sent each 5 s or more often
        "Remaining charge, voltage and current of the battery.",
    ),
}
"""By the name in the configuration."""
