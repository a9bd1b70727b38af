"""What each kind of vehicle claims of the standard profiles, and the resources made for them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rcp_kernel.model import Resource
from rcp_mavlink import messages as m
from rcp_mavlink.flightmodes import Family
from rcp_profiles import STANDARD, Offer, claim, offer, twist_limits

__all__ = ["claimed", "offers"]

_CLAIMS = {
    "copter": ("mobile", "aerial", "battery", "power"),
    "plane": ("aerial", "battery"),
    "vtol": ("aerial", "battery"),
    "rover": ("mobile", "battery", "power"),
    "boat": ("mobile", "battery", "power"),
}
_TURN = 2.0  # rad/s
_REBOOT = 90.0  # s
_ARMING = 15.0  # s


def offers(family: Family, fastest: float) -> list[Resource | Offer]:
    """List what a vehicle has for its profiles only, beside its own resources."""
    profiles = _claims(family)
    found: list[Resource | Offer] = []
    if "mobile" in profiles:
        # A ground vehicle can neither slide nor climb.
        aside = 0.0 if family.drives else fastest
        limits = twist_limits(x=fastest, y=aside, z=aside, yaw=_TURN)
        found.append(offer("actuator/cmd_vel", limits, live=True))
    if {"mobile", "aerial"} & set(profiles):
        found.append(offer("param/speed_limit"))
    if "aerial" in profiles:
        found.append(_return_home())
    if "power" in profiles:
        found += [
            offer("service/reset_system", timeout=_REBOOT, description="Stop, disarm and reboot the autopilot; refused in the air."),
            offer("service/enable", output=m.Armed, timeout=_ARMING, description="Arm the motors, if the vehicle's own checks allow it."),
            offer("service/disable", output=m.Armed, timeout=_ARMING, description="Disarm the motors; refused in the air."),
        ]  # fmt: skip
    return found


def _return_home() -> Offer:
    return offer(
        "action/return_home", output=m.Height, feedback=m.OnItsWay, timeout=1800.0,
        description="Return home, as `action/rtl`: a copter lands there and disarms, a plane circles.",
    )  # fmt: skip


def claimed(family: Family, own: Iterable[Resource | Offer], robot: str | None) -> list[Resource]:
    """Return the resources of a vehicle under the profiles that it has.

    A dialect may lack a message that a profile needs; then the vehicle does not claim it.
    """
    found = list(own)
    names = {one.name for one in found}
    profiles = [name for name in _claims(family) if _required(name) <= names]
    known = {definition for name in profiles for definition in _definitions(name)}
    # An offer is nothing without its profile.
    usable = [one for one in found if isinstance(one, Resource) or one.name in known]
    return claim(profiles, *usable, robot=robot)


def _claims(family: Family) -> tuple[str, ...]:
    return () if family.autopilot == "unknown" else _CLAIMS.get(family.kind, ("battery",))


def _definitions(name: str) -> set[str]:
    return {one.name for part in STANDARD[name].whole for one in part.resources}


def _required(name: str) -> set[str]:
    whole: Any = STANDARD[name].whole
    return {
        one.name for part in whole for one in part.resources if one.required and not one.gateway
    }
