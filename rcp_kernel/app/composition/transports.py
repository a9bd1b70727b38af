"""What transports and adapters get."""

from __future__ import annotations

from rcp_kernel.app.composition.access import Access
from rcp_kernel.app.composition.base import Base
from rcp_kernel.app.composition.handlers import Handlers
from rcp_kernel.app.composition.records import Records
from rcp_kernel.app.composition.requests import Requests
from rcp_kernel.app.composition.safety import Safety
from rcp_kernel.app.composition.sessions import Clients
from rcp_kernel.app.composition.system import SystemBranch
from rcp_kernel.app.composition.tree import Tree
from rcp_kernel.app.features import Features
from rcp_kernel.client_api import ClientApi, ClientApiParts
from rcp_kernel.sessions.connections import ConnectionParts
from rcp_kernel.sessions.handshake import Handshake

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
        links=tree.links,
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
        read_prompt=handlers.read.read_prompt,
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
