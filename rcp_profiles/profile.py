"""Profiles: named, versioned sets of resources with the same meaning on every robot."""

from __future__ import annotations

import re

import msgspec

from rcp_protocol.errors import PluginError
from rcp_protocol.model import BRANCHES, Operation, Resource, kind_of

__all__ = ["Definition", "Profile"]

_NAME = re.compile(r"[a-z][a-z0-9_]*(?:\.[a-z0-9_]+)*\Z")
_VERSION = re.compile(r"[1-9][0-9]*\.(?:0|[1-9][0-9]*)\Z")


class Definition(msgspec.Struct, frozen=True, kw_only=True):
    """One resource of a profile."""

    resource: Resource
    """Its name, description, types with units, and how it behaves unless a robot says otherwise:
    `safe`, `valid_for`, `max_age`, `energises`, `timeout`. The description is its meaning."""
    frame: str | None = None
    """The frame of its values (REP-103, REP-105); None: no frame."""
    required: bool = True
    """Whether every robot that claims the profile has it."""
    gateway: bool = False
    """Whether the gateway itself offers it for every robot that moves, so that backends do not."""

    @property
    def name(self) -> str:
        """The resource's name: `sensor/pose`."""
        return self.resource.name

    @property
    def operations(self) -> Operation:
        """Its minimum operations."""
        declared = self.resource.operations
        return BRANCHES[kind_of(self.name)] if declared is None else declared


class Profile(msgspec.Struct, frozen=True, kw_only=True):
    """A set of resources that a robot can claim."""

    name: str
    """`mobile`; a vendor's profile starts with the vendor's name: `acme.crane`."""
    version: str
    """`<major>.<minor>`: additions increase the minor, all other changes the major."""
    description: str
    """One sentence, ending in a full stop."""
    resources: tuple[Definition, ...]
    includes: tuple[Profile, ...] = ()
    """Profiles that are included in this one."""

    def __post_init__(self) -> None:
        if not _NAME.match(self.name):
            raise PluginError(f"profile {self.name!r}: use lower-case words, separated by dots")
        if not _VERSION.match(self.version):
            raise PluginError(f"profile {self.name}: {self.version!r} is not <major>.<minor>")

    @property
    def id(self) -> str:
        """Its name in discovery: `mobile/1.1`."""
        return f"{self.name}/{self.version}"

    @property
    def whole(self) -> tuple[Profile, ...]:
        """The profile and all included ones, without duplicates, included ones first."""
        found = {one.id: one for other in self.includes for one in other.whole}
        return (*found.values(), self)

    @property
    def definitions(self) -> dict[str, Definition]:
        """All resources by name, including those of included profiles."""
        found: dict[str, Definition] = {}
        for profile in self.whole:
            for definition in profile.resources:
                known = found.get(definition.name)
                if known is None or not known.required:
                    found[definition.name] = definition
        return found
