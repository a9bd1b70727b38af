"""The handler of each type of request, added to the router."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.requests import Requests
from rcp_gateway.composition.safety import Safety
from rcp_gateway.composition.sessions import Clients
from rcp_gateway.composition.system import SystemBranch
from rcp_gateway.composition.tree import Tree
from rcp_gateway.features import Features
from rcp_requests.actions import ActionHandler
from rcp_requests.atomic_write import AtomicWriteHandler
from rcp_requests.batch import BatchHandler
from rcp_requests.discover import DiscoverHandler
from rcp_requests.discovery import Discovery
from rcp_requests.execute import ExecuteHandler
from rcp_requests.keyed_write import KeyedWrites
from rcp_requests.ping import PingHandler
from rcp_requests.read import ReadHandler
from rcp_requests.subscribe import SubscribeHandler
from rcp_requests.write import WriteHandler
from rcp_streams.conditional import ConditionalSubscriptions

__all__ = ["Handlers", "compose_handlers"]


@dataclass(frozen=True, slots=True)
class Handlers:
    """Handlers that other parts call too."""

    read: ReadHandler
    subscribe: SubscribeHandler
    ping: PingHandler
    discovery: Discovery


def compose_handlers(
    base: Base,
    tree: Tree,
    records: Records,
    safety: Safety,
    clients: Clients,
    requests: Requests,
    system: SystemBranch,
    features: Features,
    actions: dict[str, ActionHandler],
) -> Handlers:
    """Create the handlers, and add them to the router."""
    router = requests.router
    keyed = KeyedWrites(requests.keys, base.inflight, base.loop)
    execute = ExecuteHandler(
        requests.resolver,
        requests.admission,
        safety.commands,
        records.journal,
        clients.access,
        estop=system.estop,
        services=system.branch.services,
        actions=actions,
        dry_run=features.dry_run,
        exempt=requests.exempt,
        keys=requests.keys,
        keyed=keyed,
        inflight=base.inflight,
        counts=base.counts,
        replies=records.replies,
        partners=safety.partners,
        deadman=safety.deadman,
        frames=features.frames,
    )
    made = Handlers(
        _read(base, tree, requests, system, features),
        _subscribe(base, tree, clients, requests, system, features),
        PingHandler(base.counts),
        Discovery(tree.registry, tree.sights, features.describe, features.frames),
    )
    write = _write(base, records, safety, requests, features, keyed)
    batch = BatchHandler(router.handle, base.inflight, base.turns, base.settings, base.loop)
    router.add("read", made.read.read, stepped=made.read.read_in_steps)
    router.add("status", stepped=made.read.status)
    router.add("write", write.write, stops=write.stops)
    router.add("execute", execute.execute, stepped=execute.execute_in_steps, stops=execute.stops)
    router.add("cancel", execute.cancel)
    router.add("batch", batch.batch)
    router.add("subscribe", stepped=made.subscribe.subscribe)
    router.add("unsubscribe", stepped=made.subscribe.unsubscribe)
    router.add("discover", stepped=DiscoverHandler(made.discovery, base.settings).discover)
    router.add("ping", made.ping.ping)
    return made


def _read(
    base: Base, tree: Tree, requests: Requests, system: SystemBranch, features: Features
) -> ReadHandler:
    return ReadHandler(
        tree.registry,
        requests.resolver,
        base.inflight,
        base.counts,
        base.turns,
        tree.sights,
        views=system.branch.views,
        pages=system.branch.pages,
        filters=system.branch.filters,
        frames=features.frames,
        settings=base.settings,
    )


def _subscribe(
    base: Base,
    tree: Tree,
    clients: Clients,
    requests: Requests,
    system: SystemBranch,
    features: Features,
) -> SubscribeHandler:
    return SubscribeHandler(
        requests.resolver,
        tree.hub,
        tree.links,
        ConditionalSubscriptions(tree.hub),
        clients.resume,
        clients.sessions,
        views=system.branch.views,
        by_rights=system.branch.by_rights,
        filters=system.branch.filters,
        frames=features.frames,
        settings=base.settings,
    )


def _write(
    base: Base,
    records: Records,
    safety: Safety,
    requests: Requests,
    features: Features,
    keyed: KeyedWrites,
) -> WriteHandler:
    atomic = AtomicWriteHandler(
        requests.resolver,
        requests.admission,
        base.inflight,
        safety.deadman,
        events=base.events,
        dry_run=features.dry_run,
        keyed=keyed,
        replies=records.replies,
        request_events=records.request_events,
    )
    return WriteHandler(
        requests.resolver,
        requests.admission,
        base.inflight,
        safety.deadman,
        events=base.events,
        dry_run=features.dry_run,
        keyed=keyed,
        replies=records.replies,
        request_events=records.request_events,
        turns=base.turns,
        atomic=atomic,
    )
