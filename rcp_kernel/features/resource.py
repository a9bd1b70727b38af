"""Resources of features, below `/system/`: their views and operations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from rcp_kernel.features.action import Action
from rcp_kernel.model import Resource
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.registry import Registry
from rcp_kernel.wire import Request

__all__ = ["Filter", "Pages", "Releases", "Service", "SystemResource", "View", "ViewChanges"]

View = Callable[[Session], Any]
"""Returns the value of a resource for one reader."""

Filter = Callable[[Session, Any], Any]
"""Returns the part of a sample that a session may see; None hides it."""


Releases = Callable[[Request], bool]
"""Returns whether a request only releases something; must neither block nor raise."""


class Pages(Protocol):
    """The items of a list, for one reader; made in steps, so None stands between them."""

    def __call__(self, session: Session, /, *, q: str, after: str) -> Iterator[Any]:
        """Return the items that match the words `q`, ordered by `path`, after the path `after`."""
        ...


class Service(Protocol):
    """A service of the gateway that completes immediately, or soon."""

    def __call__(self, session: Session, value: Any, /, *, dry_run: bool) -> Any:
        """Run the service, or for a dry run only check whether it could run.

        Return the result, or a coroutine that returns it: the reply is then sent when it is done. It
        is cancelled at the request's deadline, and `caller()` tells in it who asked.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class SystemResource:
    """One resource below `/system/`."""

    resource: Resource
    """Its name is `<kind>/<name>`, its path `/system/<name>`."""
    view: View | None = None
    """Returns the value for each reader; the feature calls `FeatureHost.changed` when it may
    differ."""
    by_rights: bool = False
    """Whether the list that `view` returns depends on nothing of the reader but `session.rights`, read
    before its first item: one update then builds it once for all subscribers with equal rights."""
    pages: Pages | None = None
    """Returns the items of the list that `view` shows, for a `read` with `q` or with a `cursor`; each
    item is a dictionary with its `path`."""
    shows: Filter | None = None
    """Filters each sample for each session."""
    execute: Service | None = None
    """Handles `execute`; must not block, and may return a coroutine."""
    action: Action | None = None
    """Handles `execute` as a command that may take time. The value of the resource is the list
    of its
    commands, filtered for each reader."""

    releases: Releases | None = None
    """Tells which `execute` only gives something up: it is never counted or refused by limits."""

    @property
    def path(self) -> str:
        """Its path in the tree."""
        return "/system/" + self.resource.name.partition("/")[2]


class ViewChanges:
    """Publishes samples and view changes of features."""

    def __init__(self, registry: Registry) -> None:
        self._entries = registry.entries

    def tell(self, path: str, value: Any = ()) -> None:
        """Publish a sample; the default only announces that a view has changed."""
        entry = self._entries.get(path)
        if entry is not None:  # features are made before the tree of the gateway
            entry.publish(value, None)
