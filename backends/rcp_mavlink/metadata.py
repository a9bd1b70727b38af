"""What is known of parameters beyond their type: unit, range, words, a sentence. All of it only describes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["About", "about"]


class About(NamedTuple):
    """What a parameter means."""

    text: str
    unit: str = "1"
    range: tuple[float, float] | None = None
    """Between which it makes sense; the autopilot may take others."""
    values: Mapping[str, str] = {}
    """What single values mean."""
    bits: Mapping[str, str] = {}
    """What single bits mean, by their place."""
    restart: bool = False
    """Whether it is heeded only after a restart."""

    @property
    def schema(self) -> dict[str, Any]:
        """What of it stands in the schema of its value; none of it is enforced."""
        found: dict[str, Any] = {"unit": self.unit}
        if self.range is not None:
            found["range"] = list(self.range)
        if self.values:
            found["values"] = dict(self.values)
        if self.bits:
            found["bits"] = dict(self.bits)
        if self.restart:
            found["restart"] = True
        return found


_KNOWN = {
    "WPNAV_SPEED": About("Speed over ground on the way to a place.", "cm/s"),
    "WPNAV_SPEED_UP": About("Fastest climb on the way to a place.", "cm/s"),
    "WPNAV_SPEED_DN": About("Fastest descent on the way to a place.", "cm/s"),
    "WPNAV_ACCEL": About("Acceleration on the way to a place.", "cm/s2"),
    "WPNAV_RADIUS": About("How close counts as having reached an item of a mission.", "cm"),
    "RTL_ALT": About("Height over home at which it returns; 0 is as high as it is.", "cm"),
    "RTL_SPEED": About("Speed of the return; 0 is WPNAV_SPEED.", "cm/s"),
    "RTL_LOIT_TIME": About("How long it waits over home before it lands.", "ms"),
    "LAND_SPEED": About("Speed of the last metres of a landing.", "cm/s"),
    "LAND_SPEED_HIGH": About("Speed of a landing before that; 0 is WPNAV_SPEED_DN.", "cm/s"),
    "ANGLE_MAX": About("Greatest lean angle.", "cdeg"),
    "FENCE_ENABLE": About("Whether the geofence is in force."),
    "FENCE_ALT_MAX": About("Greatest height over home inside the fence.", "m"),
    "FENCE_ALT_MIN": About("Least height over home inside the fence.", "m"),
    "FENCE_RADIUS": About("Radius of the fence round home.", "m"),
    "FENCE_TYPE": About(
        "Which fences hold, as bits: 1 height, 2 circle, 4 polygon, 8 least height."
    ),
    "FENCE_ACTION": About("What happens outside the fence: 0 only told, 1 return or land, 2 land."),
    "FS_GCS_ENABLE": About("What happens without a ground station: 0 nothing, 1 return, 5 land."),
    "FS_GCS_TIMEOUT": About("Without a ground station for so long, the failsafe acts.", "s"),
    "BATT_LOW_VOLT": About("Voltage below which the battery counts as low.", "V"),
    "BATT_CRT_VOLT": About("Voltage below which the battery counts as critical.", "V"),
    "BATT_FS_LOW_ACT": About("What happens on a low battery: 0 nothing, 1 land, 2 return."),
    "BATT_CAPACITY": About("Capacity of the battery.", "mA.h"),
    "DISARM_DELAY": About("Armed on the ground for so long, it disarms itself.", "s"),
    "GUID_TIMEOUT": About("How long a velocity or attitude stands without another.", "s"),
    "ARMING_CHECK": About("Which checks are made before arming: 1 all, 0 none."),
    "MAV_GCS_SYSID": About("System id of the ground station that is obeyed."),
    "SYSID_MYGCS": About("System id of the ground station that is obeyed."),
}


def about(name: str, published: Mapping[str, About]) -> About:
    """Return what a parameter means, or that nothing is known but its name."""
    known = published.get(name) or _KNOWN.get(name)
    return known or About(f"Parameter {name} of the autopilot.")
