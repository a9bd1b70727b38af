"""The built-in drive profiles, by the name used in the configuration."""

from __future__ import annotations

from importlib import import_module

from rcp_can.drive import Profile
from rcp_kernel.errors import ConfigError

__all__ = ["PROFILES", "profile"]

PROFILES = {
    "cia402": "cia402:PROFILE",
    "odrive": "odrive:PROFILE",
    "mit": "mit:MIT",
    "tmotor": "mit:TMOTOR",
    "damiao": "damiao:DAMIAO",
    "moteus": "moteus:PROFILE",
    "vesc": "vesc:PROFILE",
    "cybergear": "cybergear:PROFILE",
    "dronecan": "dronecan:PROFILE",
}
"""Module and name of each profile, below this package; imported when a motor uses it."""


def profile(name: str) -> Profile:
    """Return a built-in profile, or a third-party one as `module:NAME`.

    :raises ConfigError: there is no such profile.
    """
    own = PROFILES.get(name)
    module, _, attribute = (own or name).partition(":")
    try:
        found = getattr(import_module(f"{__name__}.{module}" if own else module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"unknown profile {name!r}: {error}") from error
    if not isinstance(found, Profile):
        raise ConfigError(f"{name!r} is not a profile but a {type(found).__name__}")
    return found
