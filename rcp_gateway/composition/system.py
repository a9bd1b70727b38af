"""The gateway's own branch of the tree: e-stop, status, and the resources of features."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_gateway.composition.access import Access
from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.safety import Safety
from rcp_gateway.composition.sessions import Clients
from rcp_gateway.composition.tree import Tree
from rcp_gateway.exposition import Exposition
from rcp_gateway.features import Features
from rcp_gateway.log import Recent
from rcp_gateway.status import StatusReport
from rcp_gateway.system import System
from rcp_kernel.safety.estop import Estop

__all__ = ["SystemBranch", "compose_system"]


@dataclass(frozen=True, slots=True)
class SystemBranch:
    """The branch, and its sources."""

    estop: Estop
    status: StatusReport
    exposition: Exposition
    branch: System


def compose_system(
    base: Base,
    tree: Tree,
    access: Access,
    records: Records,
    safety: Safety,
    clients: Clients,
    recent: Recent,
    features: Features,
) -> SystemBranch:
    """Declare the branch."""
    estop = Estop(
        tree.supervisors,
        safety.stops,
        safety.latches,
        safety.deadman,
        safety.commands,
        scopes=tree.scopes,
        identities=access.identities,
        settings=base.settings,
        halted=features.halted,
        record=records.safety_events.estop,
        loop=base.loop,
        clock=base.clock,
    )
    status = StatusReport(
        tree.supervisors,
        recent,
        registry=tree.registry,
        hub=tree.hub,
        sights=tree.sights,
        visibility=tree.visibility,
        identities=access.identities,
        sessions=clients.sessions,
        outbound=clients.outbound,
        journal=records.journal,
        features=features.status,
        store=records.store,
        loop=base.loop,
    )
    exposition = Exposition(
        status,
        tree.supervisors,
        registry=tree.registry,
        hub=tree.hub,
        sessions=clients.sessions,
        outbound=clients.outbound,
        journal=records.journal,
        counts=base.counts,
        store=records.store,
        features=features.metrics,
    )
    branch = System(
        status,
        estop,
        access=clients.access,
        sessions=clients.sessions,
        latches=safety.latches,
        stops=safety.stops,
        registry=tree.registry,
        sights=tree.sights,
        recent=recent,
        features=features.resources,
        reader_status=features.reader_status,
        loop=base.loop,
    )
    return SystemBranch(estop, status, exposition, branch)
