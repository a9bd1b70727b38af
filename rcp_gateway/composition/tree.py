"""The registry, who may see what of it, and the way of its samples."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_gateway.composition.base import Base
from rcp_gateway.supervisor import BackendSupervisor
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.access.sights import Sights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.tree.registry import Registry
from rcp_streams.hub import Hub
from rcp_streams.links import SubscriptionLinker

__all__ = ["Tree", "compose_tree"]


@dataclass(frozen=True, slots=True)
class Tree:
    """Resources, and their streams."""

    registry: Registry
    scopes: ScopeRights
    sights: Sights
    visibility: Visibility
    hub: Hub
    links: SubscriptionLinker
    changes: ViewChanges
    supervisors: list[BackendSupervisor]
    """Of the backends that declare the resources; the application adds and removes them."""


def compose_tree(base: Base) -> Tree:
    """Create the registry, empty."""
    registry = Registry(base.clock)
    sights = Sights(registry, base.turns)
    hub = Hub(registry, base.loop, base.settings.limits.pattern_value)
    return Tree(
        registry=registry,
        scopes=ScopeRights(registry),
        sights=sights,
        visibility=Visibility(registry, sights),
        hub=hub,
        links=SubscriptionLinker(hub, base.turns),
        changes=ViewChanges(registry),
        supervisors=[],
    )
