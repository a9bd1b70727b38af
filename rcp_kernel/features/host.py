"""The gateway as one feature sees it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.clock import Clock
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.events import Event, EventBus
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.features.robots import Robots
from rcp_kernel.features.services import FeatureServices, ServiceKey
from rcp_kernel.features.sessions import SessionDirectory
from rcp_kernel.safety.control import Control
from rcp_kernel.sessions.backpressure import shed, waiting_bytes
from rcp_kernel.sessions.delegation import Delegation
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import Request
from rcp_scheduling.turns import Turns, Work
from rcp_store.ledger import Ledger
from rcp_store.plugin_store import PluginStore
from rcp_store.store import Store

__all__ = ["FeatureHost"]

T = TypeVar("T")


class FeatureHost:
    """What a feature receives when it is created; only for the event loop's thread."""

    def __init__(
        self,
        health: FeatureHealth,
        *,
        robots: Robots,
        sessions: SessionDirectory,
        control: Control,
        delegation: Delegation,
        scopes: ScopeRights,
        visibility: Visibility,
        store: Store,
        ledger: Ledger,
        events: EventBus,
        changes: ViewChanges,
        services: FeatureServices,
        settings: Settings,
        shutdown: Shutdown,
        turns: Turns,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        self._health = health
        self._store = store
        self._events = events
        self._services = services
        self._settings = settings
        self._shutdown = shutdown
        self._turns = turns
        self.robots = robots
        """All robots: their resources, samples and conditions on these."""
        self.sessions = sessions
        """The connected sessions, and notices to them."""
        self.control = control
        """Control of robots: cancel, hand over, or bring to rest."""
        self.delegation = delegation
        """Requests in the name of principals that may be absent."""
        self.scopes = scopes
        """Scopes of the tree: their contents and rights."""
        self.visibility = visibility
        """Which parts of the tree and which robots a principal may see."""
        self.ledger = ledger
        """The tamper-evident log in the gateway's store; all features add to the same one."""
        self.changed: Callable[[str], None] = changes.tell
        """Notifies subscribers that the view at a path of the feature's may have changed."""
        self.publish: Callable[[str, Any], None] = changes.tell
        """Publishes a sample at a path of the feature's; `SystemResource.shows` filters it."""
        self.loop = loop
        """The event loop, with the gateway's monotonic time; running whenever the feature is."""
        self.clock = clock
        """The gateway's clock, for rules on ages and deadlines; the loop's time runs with it."""

    @property
    def fault(self) -> str | None:
        """The last failure of one of the feature's listeners since the start."""
        return self._health.fault

    @property
    def closing(self) -> bool:
        """Whether the gateway is shutting down: its sessions can be resumed after a restart."""
        return self._shutdown.begun

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return a service of another feature; None if no feature provides it.

        To be called whenever it is used: while features are being created, there are none.
        """
        return self._services.service(key)

    def store(self, table: str) -> PluginStore:
        """Return one of the feature's tables in the gateway's store."""
        return PluginStore(self._store, f"{self._health.name}.{table}")

    def in_steps(self, work: Work) -> None:
        """Run long work in steps, in spare turns of the event loop; the first now if possible.

        `work` must yield after at most a millisecond.
        """
        self._turns.oblige(self, work)

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
        event = Event(
            what=what,
            principal=principal,
            session=session,
            tenant=tenant,
            path=path,
            touches=touches,
            outcome=outcome,
            facts=facts,
        )
        self._events.tell(event)

    def sees_all(self, rights: Rights, paths: Iterable[str]) -> bool:
        """Return whether a principal may see all of the paths."""
        return self.visibility.sees_all(rights, paths)

    def unread_bytes(self, session: Session) -> int:
        """Estimate the number of bytes queued for a session's client."""
        return waiting_bytes(session)

    def shed(self, session: Session, reason: str) -> int:
        """Drop data queued for a client where that is allowed; return the bytes still queued.

        Best-effort subscriptions conflate; reliable ones end with `overrun` for the `reason`.
        Replies to a disconnected client are dropped and the loss is reported; replies to a
        connected one stay.
        """
        return shed(session, reason)

    def check_place(self, session: Session, request: Request) -> None:
        """Check the in-flight limit and the request id before consuming an approval.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        session.in_flight_key(request, self._settings.limits.in_flight)
