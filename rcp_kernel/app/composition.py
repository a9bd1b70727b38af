"""Builds every part of a gateway once, from the bottom up, with the parts that it uses.

Nothing is set afterwards: a part that must notify one further up keeps a list of listeners, to
which the other adds itself when it is created.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from rcp_kernel.access.acl import Rules
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.sights import Sights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.app.feature_host import GatewayFeatureHost
from rcp_kernel.app.features import ActiveFeature, Features, make
from rcp_kernel.app.kernel import Kernel
from rcp_kernel.app.log import Recent
from rcp_kernel.app.robots import GatewayRobots
from rcp_kernel.app.status import StatusReport
from rcp_kernel.app.supervisor import BackendSupervisor
from rcp_kernel.app.system import System
from rcp_kernel.client_api import ClientApi, ClientApiParts
from rcp_kernel.clock import Clock
from rcp_kernel.config.file import BackendConfig, GatewayConfig
from rcp_kernel.config.role import Rule
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.events import EventBus
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.features.commands import CommandEvents
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.features.services import FeatureServices
from rcp_kernel.requests.action_host import GatewayActionHost
from rcp_kernel.requests.actions import ActionHandler
from rcp_kernel.requests.admission import Admission, Resolver
from rcp_kernel.requests.atomic_write import AtomicWriteHandler
from rcp_kernel.requests.batch import BatchHandler
from rcp_kernel.requests.command_access import CommandAccess
from rcp_kernel.requests.commands import Commands
from rcp_kernel.requests.discover import DiscoverHandler
from rcp_kernel.requests.discovery import Discovery
from rcp_kernel.requests.execute import ExecuteHandler
from rcp_kernel.requests.exempt import Exemptions
from rcp_kernel.requests.idempotency import Keys
from rcp_kernel.requests.inflight import InFlight
from rcp_kernel.requests.journal import CommandJournal
from rcp_kernel.requests.keyed_write import KeyedWrites
from rcp_kernel.requests.long_bodies import LongBodies
from rcp_kernel.requests.ping import PingHandler
from rcp_kernel.requests.read import ReadHandler
from rcp_kernel.requests.replies import ReplyGate
from rcp_kernel.requests.request_events import RequestEvents
from rcp_kernel.requests.router import RequestRouter
from rcp_kernel.requests.subscribe import SubscribeHandler
from rcp_kernel.requests.waiting import WaitingCommands
from rcp_kernel.requests.write import WriteHandler
from rcp_kernel.safety.control import Control
from rcp_kernel.safety.estop import Estop
from rcp_kernel.safety.partners import Partners
from rcp_kernel.safety.safety import Deadman
from rcp_kernel.safety.safety_events import SafetyEvents
from rcp_kernel.safety.stop import StopController
from rcp_kernel.sessions.accounting import SessionAccounting
from rcp_kernel.sessions.conditional import ConditionalSubscriptions
from rcp_kernel.sessions.connections import ConnectionParts
from rcp_kernel.sessions.handshake import Handshake
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.streams.hub import Hub
from rcp_kernel.streams.links import Links
from rcp_kernel.streams.outbound import Outbound
from rcp_kernel.tree.latches import Latches
from rcp_kernel.tree.registry import Registry
from rcp_scheduling.timers import Deadlines
from rcp_scheduling.turns import Turns
from rcp_store.ledger import Ledger
from rcp_store.store import Store

__all__ = ["compose"]


@dataclass(frozen=True, slots=True)
class _Base:
    """Parts used by all others."""

    settings: Settings
    shutdown: Shutdown
    loop: asyncio.AbstractEventLoop
    clock: Clock
    turns: Turns
    registry: Registry
    scopes: ScopeRights
    hub: Hub
    links: Links
    conditions: Conditions
    sights: Sights
    visibility: Visibility
    rules: Rules
    counts: RequestCounts
    deadlines: Deadlines
    inflight: InFlight
    changes: ViewChanges
    events: CommandEvents
    supervisors: list[BackendSupervisor]


@dataclass(frozen=True, slots=True)
class _Records:
    """The store, and the listeners to events."""

    store: Store
    events: EventBus
    safety_events: SafetyEvents
    replies: ReplyGate
    journal: CommandJournal


@dataclass(frozen=True, slots=True)
class _Motion:
    """Motion and stops of robots."""

    partners: Partners
    deadman: Deadman
    commands: Commands
    latches: Latches
    stops: StopController


@dataclass(frozen=True, slots=True)
class _Clients:
    """Sessions, their principals, and their subscriptions and commands."""

    identities: Identities
    outbound: Outbound
    accounting: SessionAccounting
    resume: SessionResume
    sessions: Sessions
    access: CommandAccess


@dataclass(frozen=True, slots=True)
class _Requests:
    """Checks of a request before its handler."""

    router: RequestRouter
    exempt: Exemptions
    long_bodies: LongBodies
    resolver: Resolver
    admission: Admission
    keys: Keys
    events: RequestEvents


@dataclass(frozen=True, slots=True)
class _System:
    """The gateway's own branch, and its sources."""

    estop: Estop
    status: StatusReport
    branch: System


@dataclass(frozen=True, slots=True)
class _Handlers:
    """Handlers that other parts call too."""

    read: ReadHandler
    subscribe: SubscribeHandler


def compose(
    config: GatewayConfig,
    loop: asyncio.AbstractEventLoop,
    *,
    store: Store,
    recent: Recent,
    clock: Clock,
    features: Sequence[ActiveFeature] = (),
) -> Kernel:
    """Build a gateway without backends that does not serve yet."""
    base = _base(config, loop, clock, _grants(features))
    records = _records(base, store)
    motion = _motion(base, records)
    clients = _clients(base, records, motion)
    made = _features(base, records, motion, clients, features)
    requests = _requests(base, records, made)
    system = _system(base, records, motion, clients, recent, made)
    handlers = _handlers(base, records, motion, clients, requests, system, made)
    return Kernel(
        settings=base.settings,
        shutdown=base.shutdown,
        loop=loop,
        registry=base.registry,
        hub=base.hub,
        conditions=base.conditions,
        rules=base.rules,
        counts=base.counts,
        store=store,
        event_bus=records.events,
        journal=records.journal,
        events=base.events,
        deadman=motion.deadman,
        commands=motion.commands,
        stops=motion.stops,
        identities=clients.identities,
        outbound=clients.outbound,
        resume=clients.resume,
        sessions=clients.sessions,
        status=system.status,
        system=system.branch,
        features=made,
        admission=requests.admission,
        supervisors=base.supervisors,
        supervise=_supervise(base, records, motion),
        client_api=_client_api(base, records, motion, clients, requests, system, handlers, made),
    )


def _grants(features: Sequence[ActiveFeature]) -> dict[str, tuple[Rule, ...]]:
    """Return the rules that features add to built-in roles."""
    grants: dict[str, tuple[Rule, ...]] = {}
    for feature in features:
        for role, rules in feature.kind.grants.items():
            grants[role] = (*grants.get(role, ()), *rules)
    return grants


def _base(
    config: GatewayConfig,
    loop: asyncio.AbstractEventLoop,
    clock: Clock,
    grants: Mapping[str, Sequence[Rule]],
) -> _Base:
    registry, turns = Registry(clock), Turns(loop)
    sights = Sights(registry, turns)
    hub = Hub(registry, loop, config.limits.pattern_value)
    conditions = Conditions(hub, clock)
    settings, counts = Settings(config), RequestCounts()
    deadlines = Deadlines(loop)
    return _Base(
        settings=settings,
        shutdown=Shutdown(),
        loop=loop,
        clock=clock,
        turns=turns,
        registry=registry,
        scopes=ScopeRights(registry),
        hub=hub,
        links=Links(hub, turns),
        conditions=conditions,
        sights=sights,
        visibility=Visibility(registry, sights),
        rules=Rules(config.roles, conditions, grants),
        counts=counts,
        deadlines=deadlines,
        inflight=InFlight(settings, counts, turns, deadlines, loop),
        changes=ViewChanges(registry),
        events=CommandEvents(),
        supervisors=[],
    )


def _records(base: _Base, store: Store) -> _Records:
    events = EventBus()
    replies = ReplyGate(base.settings, base.loop)
    journal = CommandJournal(store, base.settings, base.counts, replies, base.clock)
    return _Records(store, events, SafetyEvents(events), replies, journal)


def _features(
    base: _Base,
    records: _Records,
    motion: _Motion,
    clients: _Clients,
    active: Sequence[ActiveFeature],
) -> Features:
    """Create the features, and connect them to the parts that they extend."""
    services = FeatureServices()
    host = partial(
        GatewayFeatureHost,
        robots=partial(
            GatewayRobots,
            hub=base.hub,
            conditions=base.conditions,
            backends=base.supervisors,
        ),
        changes=base.changes,
        store=records.store,
        events=records.events,
        ledger=Ledger(records.store),
        visibility=base.visibility,
        settings=base.settings,
        sessions=clients.sessions,
        control=Control(motion.commands, motion.deadman),
        scopes=base.scopes,
        shutdown=base.shutdown,
        turns=base.turns,
        services=services,
        loop=base.loop,
        clock=base.clock,
    )
    made = make(active, host)
    services.ask(made)
    records.events.listeners += made.event_listeners
    records.journal.listeners += made.command_listeners
    records.replies.demands += made.recorders
    base.events.configure(made.observers)
    clients.identities.ask(made.authenticators)
    clients.accounting.ask(made.accounting)
    clients.sessions.on_end.append(made.session_ended)
    clients.sessions.on_review.append(made.rights_changed)
    return made


def _motion(base: _Base, records: _Records) -> _Motion:
    partners = Partners(base.registry)
    deadman = Deadman(
        base.loop,
        sending=base.events.stopping,
        at_rest=base.events.rested,
        untaken=partners.halt,
        note=records.safety_events.dead_man,
    )
    commands = Commands(
        records.journal,
        base.turns,
        base.deadlines,
        base.loop,
        base.clock,
        base.settings,
    )
    latches = Latches(records.store)
    latches.on_change.append(base.registry.state_changed)
    return _Motion(
        partners,
        deadman,
        commands,
        latches,
        StopController(base.loop, records.safety_events.stop_step),
    )


def _clients(base: _Base, records: _Records, motion: _Motion) -> _Clients:
    settings, loop, commands = base.settings, base.loop, motion.commands
    identities = Identities(settings, loop, base.clock)
    outbound = Outbound(loop, settings.limits)
    known: dict[str, Session] = {}
    accounting = SessionAccounting(known, records.journal.running)
    resume = SessionResume(records.store, settings, base.shutdown, loop, base.clock)
    sessions = Sessions(
        known,
        settings=settings,
        shutdown=base.shutdown,
        rules=base.rules,
        identities=identities,
        accounting=accounting,
        commands=commands,
        resume=resume,
        events=records.events,
        links=base.links,
        outbound=outbound,
        loop=loop,
        clock=base.clock,
    )
    # What they may see is computed in steps from now on, so that a stop need not wait for it.
    for heard in (sessions.on_begin, sessions.on_renewal):
        heard.append(lambda session: base.sights.look(session.rights))
    access = CommandAccess(records.journal, base.visibility, identities)
    return _Clients(identities, outbound, accounting, resume, sessions, access)


def _requests(
    base: _Base,
    records: _Records,
    features: Features,
) -> _Requests:
    resolver = Resolver(base.registry)
    events = RequestEvents(records.events, records.replies)
    long_bodies = LongBodies(resolver, features.actions)
    admission = Admission(
        resolver,
        base.events,
        records.replies,
        base.shutdown,
        features.guards,
    )
    keys = Keys(records.store, base.loop, base.clock)
    keys.load(records.journal.find)
    exempt = Exemptions(features.releases)
    return _Requests(
        RequestRouter(
            base.settings,
            base.turns,
            base.counts,
            events,
            long_bodies,
            features.actions,
            exempt,
        ),
        exempt,
        long_bodies,
        resolver,
        admission,
        keys,
        events,
    )


def _system(
    base: _Base,
    records: _Records,
    motion: _Motion,
    clients: _Clients,
    recent: Recent,
    features: Features,
) -> _System:
    estop = Estop(
        base.supervisors,
        motion.stops,
        motion.latches,
        motion.deadman,
        motion.commands,
        scopes=base.scopes,
        identities=clients.identities,
        settings=base.settings,
        halted=features.halted,
        record=records.safety_events.estop,
        loop=base.loop,
        clock=base.clock,
    )
    status = StatusReport(
        base.supervisors,
        recent,
        registry=base.registry,
        hub=base.hub,
        sights=base.sights,
        visibility=base.visibility,
        identities=clients.identities,
        sessions=clients.sessions,
        outbound=clients.outbound,
        journal=records.journal,
        counts=base.counts,
        features=features.status,
        store=records.store,
        metrics=features.metrics,
        loop=base.loop,
    )
    branch = System(
        status,
        estop,
        access=clients.access,
        sessions=clients.sessions,
        latches=motion.latches,
        stops=motion.stops,
        registry=base.registry,
        sights=base.sights,
        recent=recent,
        features=features.resources,
        reader_status=features.reader_status,
        loop=base.loop,
    )
    return _System(estop, status, branch)


def _handlers(
    base: _Base,
    records: _Records,
    motion: _Motion,
    clients: _Clients,
    requests: _Requests,
    system: _System,
    features: Features,
) -> _Handlers:
    """Create the handlers, and add them to the router."""
    router, inflight = requests.router, base.inflight
    read = ReadHandler(
        base.registry,
        requests.resolver,
        inflight,
        base.counts,
        base.turns,
        base.sights,
        views=system.branch.views,
        pages=system.branch.pages,
        filters=system.branch.filters,
        frames=features.frames,
        settings=base.settings,
    )
    subscribe = SubscribeHandler(
        requests.resolver,
        base.hub,
        base.links,
        ConditionalSubscriptions(base.hub),
        clients.resume,
        clients.sessions,
        views=system.branch.views,
        by_rights=system.branch.by_rights,
        filters=system.branch.filters,
        frames=features.frames,
        settings=base.settings,
    )
    keyed = KeyedWrites(requests.keys, inflight, base.loop)
    atomic = AtomicWriteHandler(
        requests.resolver,
        requests.admission,
        inflight,
        motion.deadman,
        events=base.events,
        dry_run=features.dry_run,
        keyed=keyed,
        replies=records.replies,
        request_events=requests.events,
    )
    write = WriteHandler(
        requests.resolver,
        requests.admission,
        inflight,
        motion.deadman,
        events=base.events,
        dry_run=features.dry_run,
        keyed=keyed,
        replies=records.replies,
        request_events=requests.events,
        turns=base.turns,
        atomic=atomic,
    )
    execute = ExecuteHandler(
        requests.resolver,
        requests.admission,
        motion.commands,
        records.journal,
        clients.access,
        estop=system.estop,
        services=system.branch.services,
        actions=_actions(base, records, motion, clients, requests, system, features),
        dry_run=features.dry_run,
        exempt=requests.exempt,
        keys=requests.keys,
        keyed=keyed,
        inflight=inflight,
        counts=base.counts,
        replies=records.replies,
        partners=motion.partners,
        deadman=motion.deadman,
        frames=features.frames,
    )
    batch = BatchHandler(router.handle, inflight, base.turns, base.settings, base.loop)
    router.add("read", read.read, stepped=read.read_in_steps)
    router.add("status", stepped=read.status)
    router.add("write", write.write, stops=write.stops)
    router.add("execute", execute.execute, stepped=execute.execute_in_steps, stops=execute.stops)
    router.add("cancel", execute.cancel)
    router.add("batch", batch.batch)
    router.add("subscribe", stepped=subscribe.subscribe)
    router.add("unsubscribe", stepped=subscribe.unsubscribe)
    return _Handlers(read, subscribe)


def _actions(
    base: _Base,
    records: _Records,
    motion: _Motion,
    clients: _Clients,
    requests: _Requests,
    system: _System,
    features: Features,
) -> dict[str, ActionHandler]:
    """Create the gateway's own long-running actions, by path."""
    host = GatewayActionHost(
        handle=requests.router.handle,
        resolver=requests.resolver,
        foresee=features.foresee,
        frames=features.frames,
        commands=motion.commands,
        journal=records.journal,
        conditions=base.conditions,
        registry=base.registry,
        services=features,
        personal=(system.branch.views, system.branch.filters),
        events=requests.events,
        turns=base.turns,
        loop=base.loop,
    )
    return {
        path: ActionHandler(
            path,
            action,
            WaitingCommands(clients.access, motion.commands),
            host=host,
            journal=records.journal,
            resolver=requests.resolver,
            registry=base.registry,
            changes=base.changes,
            loop=base.loop,
        )
        for path, action in features.actions.items()
    }


def _supervise(
    base: _Base, records: _Records, motion: _Motion
) -> Callable[[BackendConfig], BackendSupervisor]:
    return partial(
        BackendSupervisor,
        registry=base.registry,
        hub=base.hub,
        commands=motion.commands,
        journal=records.journal,
        latches=motion.latches,
        stops=motion.stops,
        events=records.safety_events,
        shutdown=base.shutdown,
        loop=base.loop,
    )


def _client_api(
    base: _Base,
    records: _Records,
    motion: _Motion,
    clients: _Clients,
    requests: _Requests,
    system: _System,
    handlers: _Handlers,
    features: Features,
) -> ClientApi:
    discovery = Discovery(base.registry, base.sights, features.describe, features.frames)
    requests.router.add("discover", stepped=DiscoverHandler(discovery, base.settings).discover)
    ping = PingHandler(base.counts)
    requests.router.add("ping", ping.ping)
    handshake = Handshake(
        clients.sessions,
        settings=base.settings,
        rules=base.rules,
        identities=clients.identities,
        accounting=clients.accounting,
        commands=motion.commands,
        resume=clients.resume,
        subscribe=handlers.subscribe.restore,
        links=base.links,
        follower=records.replies.follower,
    )
    connections = ConnectionParts(
        handle=requests.router.handle,
        prepare=requests.long_bodies.prepare,
        at_once={"read": handlers.read.read_at_once, "ping": ping.ping_at_once},
        handshake=handshake,
        sessions=clients.sessions,
        identities=clients.identities,
        unwelcome=requests.events.unwelcome,
        counts=base.counts,
        outbound=clients.outbound,
        settings=base.settings,
        scheduler=base.hub.flush_scheduler,
        turns=base.turns,
        loop=base.loop,
    )
    parts = ClientApiParts(
        connections=connections,
        settings=base.settings,
        shutdown=base.shutdown,
        rules=base.rules,
        identities=clients.identities,
        visibility=base.visibility,
        sessions=clients.sessions,
        handshake=handshake,
        outbound=clients.outbound,
        discovery=discovery,
        access=clients.access,
        features=features,
        replies=records.replies,
        events=requests.events,
        counts=base.counts,
        store=records.store,
        status=system.status,
        is_stop=requests.router.is_stop,
        turns=base.turns,
        loop=base.loop,
    )
    return ClientApi(parts, "gateway", [])
