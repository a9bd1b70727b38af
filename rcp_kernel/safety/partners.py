"""Several backends of one robot: what one of them cannot stop, the others bring to rest."""

from __future__ import annotations

import asyncio

import structlog

from rcp_kernel.safety.retry import retry_until_confirmed
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_kernel.tree.registry import Registry

__all__ = ["Partners"]

log = structlog.get_logger("rcp.safety")


class Partners:
    """Finds the other backends of a robot, and halts them."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry

    def of(self, entry: Entry) -> list[RobotUnit]:
        """List the other parts of the robot that an entry belongs to, as far as they move."""
        found = (
            other.unit
            for other in self._registry.entries.values()
            if other.moves
            and other.owner is not entry.owner
            and other.unit.identity == entry.unit.identity
        )
        return list(dict.fromkeys(found))

    def halt(self, entry: Entry) -> list[asyncio.Task[None]]:
        """Halt the partners because an actuator's safe value is not accepted; return the tasks."""
        units = self.of(entry)
        if units:
            names = [unit.name for unit in units]
            log.warning("halted_by_partners", path=entry.path, backends=names)
        return [
            retry_until_confirmed(unit.halt, "halt_failed", backend=unit.name) for unit in units
        ]
