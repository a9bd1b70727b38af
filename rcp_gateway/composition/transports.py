"""What transports and adapters get."""

from __future__ import annotations

from rcp_gateway.client_api import ClientApi, ClientApiParts
from rcp_gateway.composition.access import Access
from rcp_gateway.composition.base import Base
from rcp_gateway.composition.handlers import Handlers
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.requests import Requests
from rcp_gateway.composition.safety import Safety
from rcp_gateway.composition.sessions import Clients
from rcp_gateway.composition.system import SystemBranch
from rcp_gateway.composition.tree import Tree
from rcp_gateway.features import Features
from rcp_requests.connections import ConnectionParts
from rcp_requests.handshake import Handshake

__all__ = ["compose_client_api"]


def compose_client_api(
    base: Base,
    tree: Tree,
    access: Access,
    records: Records,
    safety: Safety,
    clients: Clients,
    requests: Requests,
    system: SystemBranch,
    handlers: Handlers,
    features: Features,
) -> ClientApi:
    """Create the API through which clients of all protocols come in."""
    handshake = Handshake(
        clients.sessions,
        settings=base.settings,
        rules=access.rules,
        identities=access.identities,
        accounting=clients.accounting,
        commands=safety.commands,
        resume=clients.resume,
        subscribe=handlers.subscribe.restore,
        follower=records.replies.follower,
    )
    connections = ConnectionParts(
        handle=requests.router.handle,
        prepare=requests.long_bodies.prepare,
        at_once={"read": handlers.read.read_at_once, "ping": handlers.ping.ping_at_once},
        handshake=handshake,
        sessions=clients.sessions,
        identities=access.identities,
        refuse_hello=records.request_events.hello_refused,
        counts=base.counts,
        outbound=clients.outbound,
        settings=base.settings,
        scheduler=tree.hub.flush_scheduler,
        turns=base.turns,
        loop=base.loop,
    )
    parts = ClientApiParts(
        connections=connections,
        settings=base.settings,
        shutdown=base.shutdown,
        rules=access.rules,
        identities=access.identities,
        visibility=tree.visibility,
        sessions=clients.sessions,
        handshake=handshake,
        outbound=clients.outbound,
        discovery=handlers.discovery,
        access=clients.access,
        features=features,
        replies=records.replies,
        events=records.request_events,
        counts=base.counts,
        store=records.store,
        status=system.status,
        exposition=system.exposition.write,
        is_stop=requests.router.is_stop,
        turns=base.turns,
        loop=base.loop,
    )
    return ClientApi(parts, "gateway", [])
