"""Resources of the gateway's own: below `/system/`, each with what it shows to whom and what it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from rcp_kernel.features.action import Action
from rcp_kernel.model import Resource
from rcp_kernel.sessions.session import Session

__all__ = ["Filter", "Service", "SystemResource", "View", "ViewChanges"]

View = Callable[[Session], Any]
"""Makes the value of a resource for whoever asks."""

Filter = Callable[[Session, Any], Any]
"""Returns what a session may see of a sample, None for one that is hidden from it."""


class Service(Protocol):
    """Something that the gateway itself does, in no time."""

    def __call__(self, session: Session, value: Any, /, *, dry_run: bool) -> Any:
        """Do it, or for a dry run only check whether it could be done."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class SystemResource:
    """One resource below `/system/`."""

    resource: Resource
    """Its name is `<kind>/<name>`, its path `/system/<name>`."""
    view: View | None = None
    """Makes its value for each reader; the feature calls `FeatureHost.changed` when it may differ."""
    shows: Filter | None = None
    """Decides of each sample who sees what of it."""
    execute: Service | None = None
    """Does what an `execute` asks for; must not block."""
    action: Action | None = None
    """Does what an `execute` asks for as a command, for as long as it takes. The value of the
    resource is the list of its commands: each reader gets those that it may see."""

    @property
    def path(self) -> str:
        """Where it is in the tree."""
        return "/system/" + self.resource.name.partition("/")[2]


class ViewChanges:
    """Passes on what features publish, and that their views have changed."""

    def __init__(self) -> None:
        self.on_change: list[Callable[[str, Any], None]] = []
        """Called with the path, and the sample that is published there."""

    def tell(self, path: str, value: Any = ()) -> None:
        """Pass a sample on; by default one that only says that a view has changed."""
        for changed in self.on_change:
            changed(path, value)
