"""The long-running actions that features offer, by path."""

from __future__ import annotations

from rcp_gateway.composition.access import Access
from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.requests import Requests
from rcp_gateway.composition.safety import Safety
from rcp_gateway.composition.sessions import Clients
from rcp_gateway.composition.system import SystemBranch
from rcp_gateway.composition.tree import Tree
from rcp_gateway.features import Features
from rcp_requests.action_host import GatewayActionHost
from rcp_requests.actions import ActionHandler
from rcp_requests.waiting import WaitingCommands

__all__ = ["compose_actions"]


def compose_actions(
    base: Base,
    tree: Tree,
    access: Access,
    records: Records,
    safety: Safety,
    clients: Clients,
    requests: Requests,
    system: SystemBranch,
    features: Features,
) -> dict[str, ActionHandler]:
    """Create their handlers."""
    host = GatewayActionHost(
        handle=requests.router.handle,
        resolver=requests.resolver,
        foresee=features.foresee,
        frames=features.frames,
        commands=safety.commands,
        journal=records.journal,
        conditions=access.conditions,
        registry=tree.registry,
        services=features,
        personal=(system.branch.views, system.branch.filters),
        events=records.request_events,
        turns=base.turns,
        loop=base.loop,
    )
    return {
        path: ActionHandler(
            path,
            action,
            WaitingCommands(clients.access, safety.commands),
            host=host,
            journal=records.journal,
            resolver=requests.resolver,
            registry=tree.registry,
            changes=tree.changes,
            loop=base.loop,
        )
        for path, action in features.actions.items()
    }
