"""Who somebody is, and what the rules allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rcp_gateway.composition.base import Base
from rcp_gateway.composition.tree import Tree
from rcp_gateway.features import ActiveFeature
from rcp_kernel.access.acl import Rules
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.access.identities import Identities
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import Rule

__all__ = ["Access", "compose_access"]


@dataclass(frozen=True, slots=True)
class Access:
    """Principals and rules."""

    conditions: Conditions
    rules: Rules
    identities: Identities


def compose_access(
    config: GatewayConfig, base: Base, tree: Tree, features: Sequence[ActiveFeature]
) -> Access:
    """Create the rules of the configuration, with those that features add."""
    conditions = Conditions(tree.hub, base.clock)
    return Access(
        conditions,
        Rules(config.roles, conditions, _grants(features)),
        Identities(base.settings, base.loop, base.clock),
    )


def _grants(features: Sequence[ActiveFeature]) -> dict[str, tuple[Rule, ...]]:
    """Return the rules that features add to built-in roles."""
    grants: dict[str, tuple[Rule, ...]] = {}
    for feature in features:
        for role, rules in feature.kind.grants.items():
            grants[role] = (*grants.get(role, ()), *rules)
    return grants
