"""What a feature receives: a few abilities of the gateway, never the gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.turns import Work
from rcp_kernel.features.robots import Robots
from rcp_kernel.features.sessions import SessionDirectory
from rcp_kernel.safety.control import Control
from rcp_kernel.sessions.session import Session
from rcp_kernel.store.ledger import Ledger
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
        """All robots: their resources, what these say, and conditions on it."""
        ...

    @property
    def sessions(self) -> SessionDirectory:
        """Who is there, and how to tell them something."""
        ...

    @property
    def control(self) -> Control:
        """What robots are commanded: withdrawn, handed over, or brought to rest."""
        ...

    @property
    def scopes(self) -> ScopeRights:
        """Parts of the tree: what is there, and who may do what in them."""
        ...

    @property
    def fault(self) -> str | None:
        """What of the feature failed last where it should only have listened, since the start."""
        ...

    @property
    def closing(self) -> bool:
        """Whether the gateway is on its way down: sessions end that the next run resumes."""
        ...

    def in_steps(self, work: Work) -> None:
        """Do something long in the turns of the loop that have time for it, now if there is one.

        `work` yields after each millisecond at the latest.
        """
        ...

    def changed(self, path: str) -> None:
        """Say that a view of the feature's may show something else now; subscribers get it."""
        ...

    def publish(self, path: str, value: Any) -> None:
        """Publish a sample of a resource of the feature's own; `SystemResource.shows` filters it."""
        ...

    @property
    def visibility(self) -> Visibility:
        """What of the tree and of its robots somebody may see."""
        ...

    @property
    def ledger(self) -> Ledger:
        """The tamper-evident log of the gateway's store."""
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
        """Tell of an event, as the audit log records it; returns at once.

        Who may read it follows from `tenant` and `path`, or from all paths in `touches`.
        """
        ...

    def sees_all(self, rights: Rights, paths: Iterable[str]) -> bool:
        """Tell whether somebody may see each of some paths."""
        ...

    def unread_bytes(self, session: Session) -> int:
        """Return about how many bytes wait for a session's client: a sum, made when it is asked."""
        ...

    def shed(self, session: Session, reason: str) -> int:
        """Let go of what may be let go of that waits for a client; return the bytes that still wait.

        Best effort conflates, a reliable subscription ends with `overrun` for the `reason`, replies
        for a client that is away are lost and their loss is told; those for one that is there stay.
        """
        ...

    def check_place(self, session: Session, request: Request) -> None:
        """Refuse a request that its session has no place for, before something is used up for it.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        ...
