"""The parts of a gateway that need no feature: resources, rights, records, stops and sessions.

Each is created once, in this order, and receives only parts created before it. A part that must
notify a later one has a list of listeners, to which the later one is added. What depends on features
is set afterwards, by `Gateway`: the handler of delegated requests, accounts, authenticators and
observers of commands.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from rcp_gateway.supervisor import BackendSupervisor
from rcp_kernel.access.acl import Rules
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.tree_views import TreeViews
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.clock import Clock
from rcp_kernel.config.file import BackendConfig, GatewayConfig
from rcp_kernel.config.role import Rule
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.events import EventBus
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.features.observer import CommandEvents
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.features.services import FeatureServices
from rcp_kernel.safety.deadman import Deadman
from rcp_kernel.safety.partners import Partners
from rcp_kernel.safety.safety_events import SafetyEvents
from rcp_kernel.safety.stop import StopController
from rcp_kernel.sessions.accounting import SessionAccounting
from rcp_kernel.sessions.delegation import Delegation
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.tree.latches import Latches
from rcp_kernel.tree.registry import Registry
from rcp_requests.command_access import CommandAccess
from rcp_requests.commands import Commands
from rcp_requests.inflight import InFlight
from rcp_requests.journal import CommandJournal
from rcp_requests.replies import ReplyGate
from rcp_requests.request_events import RequestEvents
from rcp_scheduling.timers import Deadlines
from rcp_scheduling.turns import Turns
from rcp_store.store import Store
from rcp_streams.hub import Hub
from rcp_streams.links import SubscriptionLinker

__all__ = ["Core"]


class Core:
    """A gateway that can stop its robots, but does not serve clients yet."""

    def __init__(
        self,
        config: GatewayConfig,
        loop: asyncio.AbstractEventLoop,
        store: Store,
        clock: Clock,
        grants: Mapping[str, Sequence[Rule]],
    ) -> None:
        """`grants` are the rules that features add to built-in roles."""
        self.loop, self.store, self.clock = loop, store, clock
        self.settings = Settings(config)
        self.shutdown = Shutdown()
        self.turns, self.deadlines = Turns(loop), Deadlines(loop)
        self.counts = RequestCounts()
        self.inflight = InFlight(self.settings, self.counts, self.turns, self.deadlines, loop)
        self.events = CommandEvents()
        self.services = FeatureServices()
        self._make_tree()
        self.conditions = Conditions(
            self.registry, clock, sustain=self.hub.sustain, is_published=self.hub.demand.holds
        )
        self.rules = Rules(config.roles, self.conditions, grants)
        self.identities = Identities(self.settings, loop, clock)
        self._make_records()
        self._make_safety()
        self._make_sessions()

    def _make_tree(self) -> None:
        self.registry = registry = Registry(self.clock)
        self.scopes = ScopeRights(registry)
        self.tree_views = TreeViews(registry, self.turns)
        self.hub = Hub(registry, self.loop, self.settings.limits.pattern_value)
        self.visibility = Visibility(registry, self.tree_views)
        self.links = SubscriptionLinker(self.hub, self.turns)
        self.changes = ViewChanges(registry)
        self.supervisors: list[BackendSupervisor] = []
        """The backends; `server.py` adds and removes them."""

    def _make_records(self) -> None:
        self.event_bus = EventBus()
        self.replies = ReplyGate(self.settings, self.loop)
        self.safety_events = SafetyEvents(self.event_bus)
        self.request_events = RequestEvents(self.event_bus, self.replies)
        self.journal = CommandJournal(
            self.store, self.settings, self.counts, self.replies, self.clock
        )

    def _make_safety(self) -> None:
        self.partners = Partners(self.registry)
        self.deadman = Deadman(
            self.loop,
            sending=self.events.stopping,
            at_rest=self.events.rested,
            escalate=self.partners.halt,
            note=self.safety_events.dead_man,
        )
        self.commands = Commands(
            self.journal, self.turns, self.deadlines, self.loop, self.clock, self.settings
        )
        self.latches = Latches(self.store)
        self.latches.on_change.append(self.registry.state_changed)
        self.stops = StopController(self.loop, self.safety_events.stop_step)

    def _make_sessions(self) -> None:
        self.outbound = Outbound(self.loop, self.settings.limits)
        known: dict[str, Session] = {}
        self.accounting = SessionAccounting(known, self.journal.running)
        self.resume = SessionResume(self.store, self.settings, self.shutdown, self.loop, self.clock)
        self.sessions = Sessions(
            known,
            settings=self.settings,
            shutdown=self.shutdown,
            rules=self.rules,
            identities=self.identities,
            accounting=self.accounting,
            commands=self.commands,
            resume=self.resume,
            events=self.event_bus,
            outbound=self.outbound,
            loop=self.loop,
            clock=self.clock,
        )
        # What they may see is computed in steps from now on, so that a stop need not wait for it.
        look = self.tree_views.look
        for listeners in (self.sessions.on_begin, self.sessions.on_renewal):
            listeners.append(lambda session: look(session.rights))
        self.delegation = Delegation(self.identities, self.sessions)
        self.access = CommandAccess(self.journal, self.visibility, self.identities)

    def supervise(self, config: BackendConfig) -> BackendSupervisor:
        """Create the supervisor of a backend from its table of the configuration."""
        return BackendSupervisor(
            config,
            registry=self.registry,
            hub=self.hub,
            commands=self.commands,
            journal=self.journal,
            latches=self.latches,
            stops=self.stops,
            events=self.safety_events,
            shutdown=self.shutdown,
            loop=self.loop,
        )
