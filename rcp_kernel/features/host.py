"""The interface to the gateway that a feature receives."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any, Protocol, TypeVar

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_kernel.features.delegation import Delegation
from rcp_kernel.features.robots import Robots
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.features.sessions import SessionDirectory
from rcp_kernel.safety.control import Control
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import Request
from rcp_scheduling.turns import Work
from rcp_store.ledger import Ledger
from rcp_store.plugin_store import PluginStore

__all__ = ["FeatureHost"]

T = TypeVar("T")


class FeatureHost(Protocol):
    """The gateway as one feature sees it; only for the event loop's thread."""

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop, with the gateway's monotonic time; running whenever the feature is."""
        ...

    @property
    def clock(self) -> Clock:
        """The gateway's clock, for rules on ages and deadlines; the loop's time runs with it."""
        ...

    @property
    def robots(self) -> Robots:
        """All robots: their resources, samples and conditions on these."""
        ...

    @property
    def sessions(self) -> SessionDirectory:
        """The connected sessions, and notices to them."""
        ...

    @property
    def control(self) -> Control:
        """Control of robots: cancel, hand over, or bring to rest."""
        ...

    @property
    def delegation(self) -> Delegation:
        """Requests in the name of principals that may be absent."""
        ...

    @property
    def scopes(self) -> ScopeRights:
        """Scopes of the tree: their contents and rights."""
        ...

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return a service of another feature; None if no feature provides it.

        To be called whenever it is used: while features are being made, there are none.
        """
        ...

    @property
    def fault(self) -> str | None:
        """The last failure of one of the feature's listeners since the start."""
        ...

    @property
    def closing(self) -> bool:
        """Whether the gateway is shutting down: its sessions can be resumed after a restart."""
        ...

    def in_steps(self, work: Work) -> None:
        """Run long work in steps, in spare turns of the event loop; the first now if possible.

        `work` must yield after at most a millisecond.
        """
        ...

    def changed(self, path: str) -> None:
        """Notify subscribers that a view of the feature may have changed."""
        ...

    def publish(self, path: str, value: Any) -> None:
        """Publish a sample of one of the feature's resources; `SystemResource.shows` filters it."""
        ...

    @property
    def visibility(self) -> Visibility:
        """Which parts of the tree and which robots a principal may see."""
        ...

    @property
    def ledger(self) -> Ledger:
        """The tamper-evident log in the gateway's store."""
        ...

    def store(self, table: str) -> PluginStore:
        """Return one of the feature's tables in the gateway's store."""
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
        """Record an event in the audit log; returns at once.

        `tenant` and `path`, or all paths in `touches`, determine who may read it.
        """
        ...

    def sees_all(self, rights: Rights, paths: Iterable[str]) -> bool:
        """Return whether a principal may see all of the paths."""
        ...

    def unread_bytes(self, session: Session) -> int:
        """Compute the approximate number of bytes queued for a session's client."""
        ...

    def shed(self, session: Session, reason: str) -> int:
        """Drop data queued for a client where that is allowed; return the bytes still queued.

        Best-effort subscriptions conflate; reliable ones end with `overrun` for the `reason`.
        Replies to a disconnected client are dropped and the loss is reported; replies to a
        connected one stay.
        """
        ...

    def check_place(self, session: Session, request: Request) -> None:
        """Refuse a request that its session cannot accept, before something is used up for it.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        ...
