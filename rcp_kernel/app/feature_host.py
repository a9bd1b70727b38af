"""The implementation of the interface that each feature receives."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.clock import Clock
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.events import Event, EventBus
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.features.delegation import Delegation
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.features.robots import Robots
from rcp_kernel.features.services import ServiceLookup
from rcp_kernel.features.sessions import SessionDirectory
from rcp_kernel.safety.control import Control
from rcp_kernel.sessions.backpressure import shed, waiting_bytes
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import Request
from rcp_scheduling.turns import Turns, Work
from rcp_store.ledger import Ledger
from rcp_store.plugin_store import PluginStore
from rcp_store.store import Store

__all__ = ["GatewayFeatureHost"]


class GatewayFeatureHost:
    """The `FeatureHost` of one feature."""

    def __init__(
        self,
        health: FeatureHealth,
        *,
        robots: Callable[[FeatureHealth], Robots],
        changes: ViewChanges,
        store: Store,
        events: EventBus,
        ledger: Ledger,
        visibility: Visibility,
        settings: Settings,
        sessions: SessionDirectory,
        control: Control,
        delegation: Delegation,
        scopes: ScopeRights,
        shutdown: Shutdown,
        turns: Turns,
        services: ServiceLookup,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        self._health = health
        self.robots = robots(health)
        self.changed = changes.tell
        """Has the view's subscribers get it again."""
        self.publish = changes.tell
        """Publishes a sample of the feature's own."""
        self._store = store
        self._events = events
        self.ledger = ledger
        self.visibility = visibility
        self._settings = settings
        self._shutdown = shutdown
        self._turns = turns
        self.service = services.service
        """Returns a service of another feature."""
        self.sessions = sessions
        self.control = control
        self.delegation = delegation
        self.scopes = scopes
        self.loop = loop
        self.clock = clock

    @property
    def fault(self) -> str | None:
        """The last failure of the feature since the start."""
        return self._health.fault

    @property
    def closing(self) -> bool:
        """Whether the gateway is shutting down."""
        return self._shutdown.begun

    def in_steps(self, work: Work) -> None:
        """Do something long in the turns that have time for it."""
        self._turns.oblige(self, work)

    def store(self, table: str) -> PluginStore:
        """Return a table named after the feature."""
        return PluginStore(self._store, f"{self._health.name}.{table}")

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
        """Tell of an event."""
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
        """Return about how many bytes wait for a session's client."""
        return waiting_bytes(session)

    def shed(self, session: Session, reason: str) -> int:
        """Drop data queued for a client; return the bytes still queued."""
        return shed(session, reason)

    def check_place(self, session: Session, request: Request) -> None:
        """Refuse a request that its session has no place for."""
        session.reserve(request, self._settings.limits.in_flight)
