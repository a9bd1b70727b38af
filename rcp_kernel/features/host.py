"""What a feature receives: a few abilities of the gateway, never the gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.turns import Work
from rcp_kernel.features.robots import Robots
from rcp_kernel.sessions.session import Session
from rcp_kernel.store.plugin_store import PluginStore
from rcp_kernel.wire import Request

__all__ = ["FeatureHost"]


class FeatureHost(Protocol):
    """The gateway as one feature sees it. For the event loop's thread only."""

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop, with the gateway's monotonic time; it runs when the feature does."""
        ...

    @property
    def robots(self) -> Robots:
        """All robots: their resources, what they say, what they do, and how to stop one."""
        ...

    def in_steps(self, work: Work) -> None:
        """Do work of any length beside everything else; it yields after a millisecond at most."""
        ...

    def tell(self, session: Session, code: str, **facts: Any) -> None:
        """Send a notice to the client of a session, or to all that share the session's principal."""
        ...

    def changed(self, path: str) -> None:
        """Say that a view of the feature's may show something else now; subscribers get it."""
        ...

    def store(self, table: str) -> PluginStore:
        """Return a table of the feature's own in the gateway's store."""
        ...

    def note(
        self,
        what: str,
        *,
        principal: Principal | None,
        session: Session | None = None,
        tenant: str | None = None,
        path: str | None = None,
        touches: Iterable[str] | None = None,
        outcome: str = "ok",
        **facts: Any,
    ) -> None:
        """Write a record to the audit log; returns at once. Facts that are None are left out.

        Who may read it follows from `tenant` and `path`, or from all paths in `touches`.
        """
        ...

    def sees_all(self, rights: Rights, paths: Iterable[str]) -> bool:
        """Tell whether somebody may see each of some paths."""
        ...

    def check_place(self, session: Session, request: Request) -> None:
        """Refuse a request that its session has no place for, before something is used up for it.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        ...
