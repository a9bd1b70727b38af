"""The makes of drives that there are, by the word of the configuration."""

from __future__ import annotations

from importlib import import_module

from rcp_can.drive import Profile

__all__ = ["PROFILES", "profile"]

PROFILES = {
    "cia402": "cia402:PROFILE",
    "odrive": "odrive:PROFILE",
    "mit": "mit:MIT",
    "tmotor": "mit:TMOTOR",
    "damiao": "mit:DAMIAO",
    "moteus": "moteus:PROFILE",
    "vesc": "vesc:PROFILE",
    "cybergear": "cybergear:PROFILE",
}
"""Module and name of each profile, below this package; imported when a motor asks for it."""


def profile(name: str) -> Profile:
    """Return a profile of `PROFILES`."""
    module, _, attribute = PROFILES[name].partition(":")
    return getattr(import_module(f"{__name__}.{module}"), attribute)
