"""The handler of each type of request, added to the router."""

from __future__ import annotations

from rcp_gateway.core import Core
from rcp_gateway.features import Features
from rcp_gateway.system import System
from rcp_kernel.safety.estop import Estop
from rcp_requests.action_host import GatewayActionHost
from rcp_requests.actions import ActionHandler
from rcp_requests.admission import Admission, Resolver
from rcp_requests.atomic_write import AtomicWriteHandler
from rcp_requests.batch import BatchHandler
from rcp_requests.discover import DiscoverHandler
from rcp_requests.discovery import Discovery
from rcp_requests.execute import ExecuteHandler
from rcp_requests.exempt import Exemptions
from rcp_requests.idempotency import Keys
from rcp_requests.keyed_write import KeyedWrites
from rcp_requests.long_bodies import LongBodies
from rcp_requests.ping import PingHandler
from rcp_requests.read import ReadHandler
from rcp_requests.reader_views import ReaderViews
from rcp_requests.router import RequestRouter
from rcp_requests.services import ServiceHandler
from rcp_requests.subscribe import SubscribeHandler
from rcp_requests.waiting import WaitingCommands
from rcp_requests.write import WriteHandler
from rcp_streams.conditional import ConditionalSubscriptions

__all__ = ["Handlers"]


class Handlers:
    """The router with all handlers, and the parts of these that connections use too."""

    def __init__(self, core: Core, features: Features, estop: Estop, system: System) -> None:
        self._core, self._features, self._system = core, features, system
        self._resolver = Resolver(core.registry)
        self._keys = Keys(core.store, core.loop, core.clock)
        self._keys.load(core.journal.find)
        self._keyed = KeyedWrites(self._keys, core.inflight, core.loop)
        self._exempt = Exemptions(features.releases)
        self.admission = Admission(
            self._resolver, core.events, core.replies, core.shutdown, features.guards
        )
        self.long_bodies = LongBodies(self._resolver, features.actions)
        self.router = RequestRouter(
            core.settings,
            core.turns,
            core.counts,
            core.request_events,
            self.long_bodies,
            features.actions,
            self._exempt,
        )
        self.read = self._make_read()
        self.subscribe = self._make_subscribe()
        self.ping = PingHandler(core.counts)
        self.discovery = Discovery(
            core.registry, core.tree_views, features.describe, features.frames
        )
        self._fill_router(self._make_execute(estop), self._make_write())

    def _fill_router(self, execute: ExecuteHandler, write: WriteHandler) -> None:
        router, core = self.router, self._core
        batch = BatchHandler(router.handle, core.inflight, core.turns, core.settings, core.loop)
        discover = DiscoverHandler(self.discovery, core.settings)
        router.add("read", self.read.read, stepped=self.read.read_in_steps)
        router.add("status", stepped=self.read.status)
        router.add("write", write.write, stops=write.stops)
        router.add(
            "execute", execute.execute, stepped=execute.execute_in_steps, stops=execute.stops
        )
        router.add("cancel", execute.cancel)
        router.add("batch", batch.batch)
        router.add("subscribe", stepped=self.subscribe.subscribe)
        router.add("unsubscribe", stepped=self.subscribe.unsubscribe)
        router.add("discover", stepped=discover.discover)
        router.add("ping", self.ping.ping)

    def _make_read(self) -> ReadHandler:
        core, system = self._core, self._system
        return ReadHandler(
            core.registry,
            self._resolver,
            core.inflight,
            core.counts,
            core.turns,
            views=ReaderViews(
                system.views, system.pages, system.filters, core.tree_views, core.settings
            ),
            frames=self._features.frames,
            settings=core.settings,
        )

    def _make_subscribe(self) -> SubscribeHandler:
        core, system = self._core, self._system
        return SubscribeHandler(
            self._resolver,
            core.hub,
            core.links,
            ConditionalSubscriptions(core.hub),
            core.resume,
            core.sessions,
            views=system.views,
            by_rights=system.by_rights,
            filters=system.filters,
            frames=self._features.frames,
            settings=core.settings,
        )

    def _make_write(self) -> WriteHandler:
        core = self._core
        atomic = AtomicWriteHandler(
            self._resolver,
            self.admission,
            core.inflight,
            core.deadman,
            events=core.events,
            dry_run=self._features.dry_run,
            keyed=self._keyed,
            replies=core.replies,
            request_events=core.request_events,
        )
        return WriteHandler(
            self._resolver,
            self.admission,
            core.inflight,
            core.deadman,
            events=core.events,
            dry_run=self._features.dry_run,
            keyed=self._keyed,
            replies=core.replies,
            request_events=core.request_events,
            turns=core.turns,
            atomic=atomic,
        )

    def _make_execute(self, estop: Estop) -> ExecuteHandler:
        core = self._core
        services = ServiceHandler(
            self._system.services,
            estop,
            inflight=core.inflight,
            keyed=self._keyed,
            replies=core.replies,
            counts=core.counts,
        )
        return ExecuteHandler(
            self._resolver,
            self.admission,
            core.commands,
            core.journal,
            core.access,
            services=services,
            actions=self._make_actions(),
            dry_run=self._features.dry_run,
            exempt=self._exempt,
            keys=self._keys,
            partners=core.partners,
            deadman=core.deadman,
            frames=self._features.frames,
        )

    def _make_actions(self) -> dict[str, ActionHandler]:
        """Create the handlers of the long-running actions of features, by path."""
        core, system = self._core, self._system
        host = GatewayActionHost(
            handle=self.router.handle,
            resolver=self._resolver,
            long_bodies=self.long_bodies,
            settings=core.settings,
            foresee=self._features.foresee,
            frames=self._features.frames,
            commands=core.commands,
            journal=core.journal,
            conditions=core.conditions,
            registry=core.registry,
            services=core.services,
            personal=(system.views, system.filters),
            events=core.request_events,
            turns=core.turns,
            loop=core.loop,
        )
        return {
            path: ActionHandler(
                path,
                action,
                WaitingCommands(core.access, core.commands),
                host=host,
                journal=core.journal,
                resolver=self._resolver,
                registry=core.registry,
                changes=core.changes,
                loop=core.loop,
            )
            for path, action in self._features.actions.items()
        }
