"""A whole gateway: its core, and the features, requests and clients around it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from rcp_gateway.client_api import ClientApi, ClientApiParts
from rcp_gateway.core import Core
from rcp_gateway.exposition import Exposition
from rcp_gateway.features import ActiveFeature, Features, make
from rcp_gateway.handlers import Handlers
from rcp_gateway.log import Recent
from rcp_gateway.mounts import Mounts
from rcp_gateway.status import StatusReport
from rcp_gateway.system import System
from rcp_kernel.clock import Clock
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import Rule
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.features.robots import Robots
from rcp_kernel.safety.control import Control
from rcp_kernel.safety.estop import Estop
from rcp_kernel.safety.estop_scopes import EstopScopes
from rcp_requests.connections import ConnectionParts
from rcp_requests.handshake import Handshake
from rcp_store.ledger import Ledger
from rcp_store.store import Store

__all__ = ["Gateway"]


class Gateway(Core):
    """A gateway without backends that does not serve yet, for `Server` and tests.

    No part of it holds it, except `Handlers`: each receives what it uses.
    """

    def __init__(
        self,
        config: GatewayConfig,
        loop: asyncio.AbstractEventLoop,
        *,
        store: Store,
        recent: Recent,
        clock: Clock,
        features: Sequence[ActiveFeature] = (),
    ) -> None:
        super().__init__(config, loop, store, clock, _grants(features))
        self.features = self._make_features(features)
        estop = self._make_estop()
        self.status = self._make_status(recent)
        self.exposition = self._make_exposition()
        self.system = self._make_system(estop, recent)
        self._handlers = Handlers(self, self.features, estop, self.system)
        self.admission = self._handlers.admission
        self.delegation.set_handler(self._handlers.router.handle)
        self.client_api = self._make_client_api()

    @property
    def moving(self) -> bool:
        """Whether a robot is driven, or carries something out."""
        return self.deadman.driving or bool(self.commands.running)

    def reconfigure(self, config: GatewayConfig, features: Sequence[ActiveFeature] = ()) -> None:
        """Apply the rules, keys and limits of another configuration, to open sessions too.

        A feature that is not among `features` keeps its table.
        """
        self.settings.replace(config)
        self.outbound.configure(config.limits)
        self.hub.pattern_value = config.limits.pattern_value
        self.rules.configure(config.roles)
        self.identities.reconfigure(config)
        self.features.reconfigure(features)
        self.events.configure(self.features.observers)
        self.admission.configure()
        self.sessions.review()

    async def close(self) -> None:
        """Cancel what runs and stop all streams; the backends are still there."""
        self.shutdown.begin()
        self.stops.close()
        self.sessions.relief.close()
        self.outbound.close()
        self.deadman.close()
        await self.commands.close()
        await self.hub.close()

    def _make_features(self, active: Sequence[ActiveFeature]) -> Features:
        """Create the features, and connect them to the parts that they extend."""
        control = Control(self.commands, self.deadman)

        ledger = Ledger(self.store)  # one, because it knows the end of the chain

        def host(health: FeatureHealth) -> FeatureHost:
            return FeatureHost(
                health,
                robots=Robots(health, self.hub, self.conditions, self.supervisors),
                sessions=self.sessions,
                control=control,
                delegation=self.delegation,
                scopes=self.scopes,
                visibility=self.visibility,
                store=self.store,
                ledger=ledger,
                events=self.event_bus,
                changes=self.changes,
                services=self.services,
                settings=self.settings,
                shutdown=self.shutdown,
                turns=self.turns,
                loop=self.loop,
                clock=self.clock,
            )

        features = make(active, host)
        for services in features.services:
            self.services.add(services)
        self.event_bus.listeners += features.event_listeners
        self.journal.listeners += features.command_listeners
        self.replies.demands += features.recorders
        self.events.configure(features.observers)
        self.identities.set_authenticators(features.authenticators)
        self.accounting.set_features(features.accounting)
        self.sessions.on_end.append(features.session_ended)
        self.sessions.on_review.append(features.rights_changed)
        return features

    def _make_estop(self) -> Estop:
        return Estop(
            self.supervisors,
            self.stops,
            self.latches,
            self.deadman,
            self.commands,
            scopes=EstopScopes(self.supervisors, self.scopes, self.identities, self.settings),
            identities=self.identities,
            settings=self.settings,
            halted=self.features.halted,
            record=self.safety_events.estop,
            loop=self.loop,
            clock=self.clock,
        )

    def _make_status(self, recent: Recent) -> StatusReport:
        return StatusReport(
            self.supervisors,
            recent,
            registry=self.registry,
            hub=self.hub,
            tree_views=self.tree_views,
            visibility=self.visibility,
            identities=self.identities,
            sessions=self.sessions,
            outbound=self.outbound,
            journal=self.journal,
            features=self.features.status,
            store=self.store,
            loop=self.loop,
        )

    def _make_exposition(self) -> Exposition:
        return Exposition(
            self.status,
            self.supervisors,
            registry=self.registry,
            hub=self.hub,
            sessions=self.sessions,
            outbound=self.outbound,
            journal=self.journal,
            counts=self.counts,
            store=self.store,
            features=self.features.metrics,
        )

    def _make_system(self, estop: Estop, recent: Recent) -> System:
        return System(
            self.status,
            estop,
            access=self.access,
            sessions=self.sessions,
            latches=self.latches,
            stops=self.stops,
            registry=self.registry,
            tree_views=self.tree_views,
            recent=recent,
            features=self.features.resources,
            reader_status=self.features.reader_status,
            loop=self.loop,
        )

    def _make_client_api(self) -> ClientApi:
        """Create the API through which clients of all protocols come in."""
        handlers = self._handlers
        handshake = Handshake(
            self.sessions,
            settings=self.settings,
            rules=self.rules,
            identities=self.identities,
            accounting=self.accounting,
            commands=self.commands,
            resume=self.resume,
            subscribe=handlers.subscribe.restore,
            follower=self.replies.follower,
        )
        connections = ConnectionParts(
            handle=handlers.router.handle,
            prepare=handlers.long_bodies.prepare,
            at_once={"read": handlers.read.read_at_once, "ping": handlers.ping.ping_at_once},
            handshake=handshake,
            sessions=self.sessions,
            identities=self.identities,
            refuse_hello=self.request_events.hello_refused,
            counts=self.counts,
            outbound=self.outbound,
            settings=self.settings,
            scheduler=self.hub.flush_scheduler,
            turns=self.turns,
            loop=self.loop,
        )
        parts = ClientApiParts(
            connections=connections,
            read_prompt=handlers.read.read_prompt,
            settings=self.settings,
            shutdown=self.shutdown,
            rules=self.rules,
            identities=self.identities,
            visibility=self.visibility,
            sessions=self.sessions,
            handshake=handshake,
            outbound=self.outbound,
            discovery=handlers.discovery,
            access=self.access,
            services=self.services,
            replies=self.replies,
            events=self.request_events,
            counts=self.counts,
            store=self.store,
            ready=self.status.ready,
            absent_adapters=self.status.absent_adapters,
            exposition=self.exposition.write,
            is_stop=handlers.router.is_stop,
            turns=self.turns,
            loop=self.loop,
        )
        return ClientApi(parts, "gateway", Mounts())


def _grants(features: Sequence[ActiveFeature]) -> dict[str, tuple[Rule, ...]]:
    """Return the rules that features add to built-in roles."""
    grants: dict[str, tuple[Rule, ...]] = {}
    for feature in features:
        for role, rules in feature.kind.grants.items():
            grants[role] = (*grants.get(role, ()), *rules)
    return grants
