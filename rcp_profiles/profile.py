"""What a profile is: a named, versioned set of resources with one meaning on every robot."""

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
    """The frame that its values are in (REP-103, REP-105); None: they are in no frame."""
    required: bool = True
    """Whether every robot that claims the profile has it."""
    gateway: bool = False
    """The gateway itself offers it for every robot that moves; a backend does not declare it."""

    @property
    def name(self) -> str:
        """The resource's name: `sensor/pose`."""
        return self.resource.name

    @property
    def operations(self) -> Operation:
        """What it offers at least."""
        declared = self.resource.operations
        return BRANCHES[kind_of(self.name)] if declared is None else declared


class Profile(msgspec.Struct, frozen=True, kw_only=True):
    """A set of resources that a robot can claim."""

    name: str
    """`mobile`; a vendor's begins with a name of the vendor's own: `acme.crane`."""
    version: str
    """`<major>.<minor>`: the minor rises with what is added, the major with all other changes."""
    description: str
    """One sentence, ending in a full stop."""
    resources: tuple[Definition, ...]
    includes: tuple[Profile, ...] = ()
    """Profiles that a robot that claims this one has as well."""

    def __post_init__(self) -> None:
        if not _NAME.match(self.name):
            raise PluginError(f"profile {self.name!r}: use lower-case words, separated by dots")
        if not _VERSION.match(self.version):
            raise PluginError(f"profile {self.name}: {self.version!r} is not <major>.<minor>")

    @property
    def id(self) -> str:
        """What discovery calls it: `mobile/1.0`."""
        return f"{self.name}/{self.version}"

    @property
    def whole(self) -> tuple[Profile, ...]:
        """The profile and all that it includes, included ones first, each once."""
        found = {one.id: one for other in self.includes for one in other.whole}
        return (*found.values(), self)

    @property
    def definitions(self) -> dict[str, Definition]:
        """All resources by name, included ones too; what one of them requires is required."""
        found: dict[str, Definition] = {}
        for profile in self.whole:
            for definition in profile.resources:
                known = found.get(definition.name)
                if known is None or not known.required:
                    found[definition.name] = definition
        return found
