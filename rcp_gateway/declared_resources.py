"""What one backend has declared, and publishes: the part of its `Host` that is about the tree.

Each robot that moves has the service `hold`; it is added here where its backend declares none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from rcp_gateway.recovery import LossRecovery
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.model import Resource, full_path
from rcp_kernel.safety.hold import hold_resource
from rcp_kernel.spi import Publication
from rcp_kernel.tree.entry import Entry, Owner, RobotUnit
from rcp_kernel.tree.registry import Registry
from rcp_requests.commands import Commands

__all__ = ["DeclaredResources"]


class ThreadedOwner(Owner, Protocol):
    """A backend that other threads can call."""

    def call_soon(self, function: Any, /, *args: Any) -> None:
        """Run a function on the event loop."""
        ...


class DeclaredResources:
    """The resources of one backend, over all its lives."""

    def __init__(
        self,
        owner: ThreadedOwner,
        tenant: str,
        registry: Registry,
        commands: Commands,
        recovery: LossRecovery,
    ) -> None:
        self.entries: dict[str, Entry] = {}
        """By the backend's own names."""
        self._owner = owner
        self._tenant = tenant
        self._registry = registry
        self._commands = commands
        self._recovery = recovery

    def declare(self, *resources: Resource) -> None:
        """Add resources to the tree."""
        owner = self._owner
        for resource in resources:
            entry = self._registry.declare(owner, resource, tenant=self._tenant, robot=owner.robot)
            self.entries[resource.name] = entry.unit.own[resource.name] = entry
            if entry.moves:
                self._offer_hold(entry.unit)
                self._recovery.find_cut_off(entry)
            if owner.has_gateways and owner.backend is not None:
                self._commands.take_up(entry, owner.backend)

    def _offer_hold(self, unit: RobotUnit) -> None:
        """Add the hold service to a robot that moves, unless it has its own."""
        name = _hold_name(unit.robot)
        if name in self.entries:
            return
        tree, tenant, robot = self._registry, self._tenant, self._owner.robot
        path = full_path(tenant, robot, name)
        if path in tree.entries:  # another backend of the same robot offers it for both
            return
        hold = hold_resource(name, unit.robot)
        entry = Entry(path, hold, self._owner, tenant, robot, tree.clock)
        entry.is_hold = True
        self.entries[name] = unit.own[name] = tree.insert(entry)

    def withdraw(self, *names: str) -> None:
        """Remove resources from the tree; their running commands end."""
        for name in names:
            entry = self.entries.pop(name, None)
            if entry is not None:
                entry.unit.own.pop(name, None)
                gone = AdapterUnavailable(f"the backend withdrew {entry.path}")
                self._commands.interrupt(entry.path, gone)
                self._registry.withdraw(entry.path)
                self._withdraw_hold(entry.unit)

    def _withdraw_hold(self, unit: RobotUnit) -> None:
        """Withdraw the hold service of a robot with nothing left that moves."""
        name = _hold_name(unit.robot)
        entry = self.entries.get(name)
        if entry is not None and entry.is_hold and not any(e.moves for e in unit.own.values()):
            self.withdraw(name)

    def publish(self, name: str, value: Any, timestamp: int | None = None) -> None:
        """Publish a value; an undeclared name is a fault."""
        entry = self.entries.get(name)
        if entry is None:
            self._owner.fault(f"published '{name}', which it did not declare")
            return
        entry.publish(value, timestamp)

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        """Publish values from any thread."""
        self._owner.call_soon(self._publish_all, batch)

    def _publish_all(self, batch: Sequence[Publication]) -> None:
        for item in batch:
            self.publish(item.name, item.value, item.timestamp)


def _hold_name(robot: str | None) -> str:
    return "service/hold" if robot is None else f"service/{robot}/hold"
