"""Profiles: a common vocabulary of resources for all kinds of robots, as data."""

from __future__ import annotations

from rcp_profiles.bounds import Keyed, bounded, twist_limits
from rcp_profiles.claim import Offer, claim, offer
from rcp_profiles.document import Change, changes, document, unannounced
from rcp_profiles.profile import Definition, Profile
from rcp_profiles.standard import STANDARD, profile_named

__all__ = [
    "STANDARD",
    "Change",
    "Definition",
    "Keyed",
    "Offer",
    "Profile",
    "bounded",
    "changes",
    "claim",
    "document",
    "offer",
    "profile_named",
    "twist_limits",
    "unannounced",
]
