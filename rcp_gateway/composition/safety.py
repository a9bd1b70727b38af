"""Commands of robots, and what stops them; it works with no feature active."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.tree import Tree
from rcp_gateway.supervisor import BackendSupervisor
from rcp_kernel.config.file import BackendConfig
from rcp_kernel.safety.partners import Partners
from rcp_kernel.safety.safety import Deadman
from rcp_kernel.safety.stop import StopController
from rcp_kernel.tree.latches import Latches
from rcp_requests.commands import Commands

__all__ = ["Safety", "compose_safety", "compose_supervisor"]


@dataclass(frozen=True, slots=True)
class Safety:
    """Motion and stops of robots."""

    partners: Partners
    deadman: Deadman
    commands: Commands
    latches: Latches
    stops: StopController


def compose_safety(base: Base, tree: Tree, records: Records) -> Safety:
    """Create them."""
    partners = Partners(tree.registry)
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
    latches.on_change.append(tree.registry.state_changed)
    return Safety(
        partners,
        deadman,
        commands,
        latches,
        StopController(base.loop, records.safety_events.stop_step),
    )


def compose_supervisor(
    base: Base, tree: Tree, records: Records, safety: Safety
) -> Callable[[BackendConfig], BackendSupervisor]:
    """Return what makes the supervisor of a backend from its table of the configuration."""
    return partial(
        BackendSupervisor,
        registry=tree.registry,
        hub=tree.hub,
        commands=safety.commands,
        journal=records.journal,
        latches=safety.latches,
        stops=safety.stops,
        events=records.safety_events,
        shutdown=base.shutdown,
        loop=base.loop,
    )
