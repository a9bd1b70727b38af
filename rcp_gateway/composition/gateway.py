"""A gateway from its parts, each of which uses only those created before it.

Nothing is set afterwards: a part that must notify one further up keeps a list of listeners, to
which the other adds itself when it is created.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from rcp_gateway.composition.access import compose_access
from rcp_gateway.composition.actions import compose_actions
from rcp_gateway.composition.base import compose_base
from rcp_gateway.composition.features import compose_features
from rcp_gateway.composition.handlers import compose_handlers
from rcp_gateway.composition.records import compose_records
from rcp_gateway.composition.requests import compose_requests
from rcp_gateway.composition.safety import compose_safety, compose_supervisor
from rcp_gateway.composition.sessions import compose_sessions
from rcp_gateway.composition.system import compose_system
from rcp_gateway.composition.transports import compose_client_api
from rcp_gateway.composition.tree import compose_tree
from rcp_gateway.features import ActiveFeature
from rcp_gateway.kernel import Kernel
from rcp_gateway.log import Recent
from rcp_kernel.clock import Clock
from rcp_kernel.config.file import GatewayConfig
from rcp_store.store import Store

__all__ = ["compose"]


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
    base = compose_base(config, loop, clock)
    tree = compose_tree(base)
    access = compose_access(config, base, tree, features)
    records = compose_records(base, store)
    safety = compose_safety(base, tree, records)
    clients = compose_sessions(base, tree, access, records, safety)
    made = compose_features(base, tree, access, records, safety, clients, features)
    requests = compose_requests(base, tree, records, made)
    clients.delegation.set_handler(requests.router.handle)
    system = compose_system(base, tree, access, records, safety, clients, recent, made)
    below = base, tree, access, records, safety, clients, requests, system
    actions = compose_actions(*below, made)
    handlers = compose_handlers(
        base, tree, records, safety, clients, requests, system, made, actions
    )
    return Kernel(
        settings=base.settings,
        shutdown=base.shutdown,
        loop=loop,
        registry=tree.registry,
        hub=tree.hub,
        conditions=access.conditions,
        rules=access.rules,
        counts=base.counts,
        store=store,
        event_bus=records.events,
        journal=records.journal,
        events=base.events,
        deadman=safety.deadman,
        commands=safety.commands,
        stops=safety.stops,
        identities=access.identities,
        outbound=clients.outbound,
        resume=clients.resume,
        sessions=clients.sessions,
        status=system.status,
        exposition=system.exposition,
        system=system.branch,
        features=made,
        admission=requests.admission,
        supervisors=tree.supervisors,
        supervise=compose_supervisor(base, tree, records, safety),
        client_api=compose_client_api(*below, handlers, made),
    )
