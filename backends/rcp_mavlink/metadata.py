"""Parameter metadata: unit, range, meaning of values, description. Nothing is enforced."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["About", "about"]


class About(NamedTuple):
    """Metadata of a parameter."""

    text: str
    unit: str = "1"
    range: tuple[float, float] | None = None
    """Recommended range; the autopilot may accept other values."""
    values: Mapping[str, str] = {}
    """Meaning of single values."""
    bits: Mapping[str, str] = {}
    """Meaning of single bits, by their number."""
    restart: bool = False
    """Whether a change takes effect only after a reboot."""
    group: str = ""
    default: float | None = None
    """Of the firmware; boards may have another."""

    @property
    def schema(self) -> dict[str, Any]:
        """Return its part of the JSON schema of the value; not enforced."""
        found: dict[str, Any] = {"unit": self.unit}
        if self.range is not None:
            found["range"] = list(self.range)
        if self.values:
            found["values"] = dict(self.values)
        if self.bits:
            found["bits"] = dict(self.bits)
        if self.restart:
            found["restart"] = True
        if self.group:
            found["group"] = self.group
        if self.default is not None:
            found["default"] = self.default
        return found


_KNOWN = {
    "WPNAV_SPEED": About("Ground speed on the way to a target.", "cm/s"),
    "WPNAV_SPEED_UP": About("Fastest climb on the way to a target.", "cm/s"),
    "WPNAV_SPEED_DN": About("Fastest descent on the way to a target.", "cm/s"),
    "WPNAV_ACCEL": About("Acceleration on the way to a target.", "cm/s2"),
    "WPNAV_RADIUS": About("Acceptance radius of a mission item.", "cm"),
    "RTL_ALT": About("Height above home of the return flight; 0 keeps the current height.", "cm"),
    "RTL_SPEED": About("Speed of the return; 0 is WPNAV_SPEED.", "cm/s"),
    "RTL_LOIT_TIME": About("Waiting time over home before it lands.", "ms"),
    "LAND_SPEED": About("Speed of the last metres of a landing.", "cm/s"),
    "LAND_SPEED_HIGH": About("Speed of a landing before that; 0 is WPNAV_SPEED_DN.", "cm/s"),
    "ANGLE_MAX": About("Maximum lean angle.", "cdeg"),
    "FENCE_ENABLE": About("Whether the geofence is enabled."),
    "FENCE_ALT_MAX": About("Maximum height above home inside the fence.", "m"),
    "FENCE_ALT_MIN": About("Minimum height above home inside the fence.", "m"),
    "FENCE_RADIUS": About("Radius of the fence around home.", "m"),
    "FENCE_TYPE": About(
        "Enabled fences as bits: 1 maximum height, 2 circle, 4 polygon, 8 minimum height."
    ),
    "FENCE_ACTION": About("Action outside the fence: 0 report only, 1 return or land, 2 land."),
    "FS_GCS_ENABLE": About("Action without a ground station: 0 none, 1 return, 5 land."),
    "FS_GCS_TIMEOUT": About("Time without a ground station before the failsafe acts.", "s"),
    "BATT_LOW_VOLT": About("Voltage below which the battery counts as low.", "V"),
    "BATT_CRT_VOLT": About("Voltage below which the battery counts as critical.", "V"),
    "BATT_FS_LOW_ACT": About("Action on a low battery: 0 none, 1 land, 2 return."),
    "BATT_CAPACITY": About("Capacity of the battery.", "mA.h"),
    "DISARM_DELAY": About("Time armed on the ground after which it disarms itself.", "s"),
    "GUID_TIMEOUT": About("Validity of a velocity or attitude set-point.", "s"),
    "ARMING_CHECK": About("Checks before arming: 1 all, 0 none."),
    "MAV_GCS_SYSID": About("System id of the ground station that the vehicle accepts."),
    "SYSID_MYGCS": About("System id of the ground station that the vehicle accepts."),
}


def about(name: str, published: Mapping[str, About]) -> About:
    """Return the metadata of a parameter; empty if nothing is known about it."""
    known = published.get(name) or _KNOWN.get(name)
    return known or About(f"Parameter {name} of the autopilot.")
