"""The active features, connected to the parts that they extend."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from rcp_gateway.composition.access import Access
from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.safety import Safety
from rcp_gateway.composition.sessions import Clients
from rcp_gateway.composition.tree import Tree
from rcp_gateway.feature_host import GatewayFeatureHost
from rcp_gateway.features import ActiveFeature, Features, make
from rcp_gateway.robots import GatewayRobots
from rcp_kernel.features.services import FeatureServices
from rcp_kernel.safety.control import Control
from rcp_store.ledger import Ledger

__all__ = ["compose_features"]


def compose_features(
    base: Base,
    tree: Tree,
    access: Access,
    records: Records,
    safety: Safety,
    clients: Clients,
    active: Sequence[ActiveFeature],
) -> Features:
    """Create the features, and add them to what they listen to and answer."""
    services = FeatureServices()
    host = partial(
        GatewayFeatureHost,
        robots=partial(
            GatewayRobots,
            hub=tree.hub,
            conditions=access.conditions,
            backends=tree.supervisors,
        ),
        changes=tree.changes,
        store=records.store,
        events=records.events,
        ledger=Ledger(records.store),
        visibility=tree.visibility,
        settings=base.settings,
        sessions=clients.sessions,
        control=Control(safety.commands, safety.deadman),
        delegation=clients.delegation,
        scopes=tree.scopes,
        shutdown=base.shutdown,
        turns=base.turns,
        services=services,
        loop=base.loop,
        clock=base.clock,
    )
    made = make(active, host)
    services.set_lookup(made)
    records.events.listeners += made.event_listeners
    records.journal.listeners += made.command_listeners
    records.replies.demands += made.recorders
    base.events.configure(made.observers)
    access.identities.set_authenticators(made.authenticators)
    clients.accounting.set_features(made.accounting)
    clients.sessions.on_end.append(made.session_ended)
    clients.sessions.on_review.append(made.rights_changed)
    return made
