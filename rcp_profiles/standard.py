"""The profiles that come with the gateway, by name."""

from __future__ import annotations

from collections.abc import Mapping

from rcp_profiles.moving import AERIAL, DRIVE, MOBILE, POWER
from rcp_profiles.parts import ARM, BATTERY, CAMERA, GRIPPER, LIDAR
from rcp_profiles.profile import Profile
from rcp_protocol.errors import PluginError
from rcp_protocol.similarity import closest

__all__ = ["STANDARD", "profile_named"]

STANDARD: dict[str, Profile] = {
    profile.name: profile
    for profile in (DRIVE, MOBILE, AERIAL, ARM, GRIPPER, BATTERY, CAMERA, LIDAR, POWER)
}


def profile_named(name: str, known: Mapping[str, Profile] = STANDARD) -> Profile:
    """Return a profile of the `known` ones.

    :raises PluginError: there is none of this name.
    """
    found = known.get(name)
    if found is None:
        near = closest(name, known)
        advice = f"did you mean '{near}'?" if near else f"there are {', '.join(known)}"
        raise PluginError(f"there is no profile '{name}': {advice}")
    return found
