"""Inventory: every robot with its kind, state, position, battery, and who has control of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from rcp_gateway.hookspecs import hookimpl
from rcp_inventory.config import InventoryConfig
from rcp_inventory.control import Controllers
from rcp_inventory.fleet import Fleet
from rcp_inventory.inventory import Inventory
from rcp_inventory.messages import Control, FactSheet, Reading, RobotState
from rcp_kernel.config.role import Rule
from rcp_kernel.contract.events import Event
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.model import Resource
from rcp_kernel.sessions.command import Command, Record

__all__ = ["Control", "FactSheet", "InventoryConfig", "Reading", "RobotState", "rcp_features"]

PATH = "/system/robots"
_LOOK = Rule(("discover", "read", "subscribe"), (PATH,))
_RESOURCE = Resource(
    name="sensor/robots",
    description="Robots that you may see: kind, state, position, battery, limits, who has control.",
    value=list[RobotState],
    history=1,
)


class _Updates:
    """Announces changes, at most once per interval. Called for each step of a command."""

    def __init__(self, config: InventoryConfig, host: FeatureHost) -> None:
        self.config = config
        self._host = host
        self._due: asyncio.TimerHandle | None = None
        self.idle = False
        """Whether an announcement is due that any change until then is a part of."""

    def changed(self) -> None:
        """Announce a change, after the interval: others will follow."""
        if not self.idle:
            self.idle = True
            self._due = self._host.loop.call_later(self.config.interval, self._announce)

    def __call__(self, command: Command, step: Record) -> None:
        """Announce that a command began or ended: its sender may have got, or lost, control."""
        self.changed()

    def _announce(self) -> None:
        self.idle = False
        self._host.changed(PATH)

    def close(self) -> None:
        """Announce nothing more."""
        if self._due is not None:
            self._due.cancel()


def _make(config: InventoryConfig, host: FeatureHost) -> Feature:
    updates = _Updates(config, host)
    controllers = Controllers(host, changed=updates.changed)
    inventory = Inventory(Fleet(host, changed=updates.changed), controllers)
    host.robots.follow_state(updates.changed)
    host.robots.follow(lambda _: None, lambda entry: controllers.forget(entry.path))

    def heard(event: Event) -> None:
        if event.what == "lease":
            updates.changed()

    def halted(paths: frozenset[str], _by: str, _reason: str) -> None:
        for path in paths:
            controllers.forget(path)

    def configure(config: InventoryConfig) -> None:
        updates.config = config

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        try:
            yield
        finally:
            updates.close()

    shown = SystemResource(
        resource=_RESOURCE, view=inventory.view, by_rights=True, pages=inventory.pages
    )
    return Feature(
        resources=(shown,),
        observer=controllers,
        on_event=heard,
        on_command=updates,
        feedback=False,
        halted=halted,
        reconfigure=configure,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Offer the inventory."""
    grants = {"viewer": (_LOOK,), "hub": (_LOOK,), "operator": (_LOOK,), "agent": (_LOOK,)}
    return [FeatureKind("inventory", InventoryConfig, _make, __doc__ or "", grants=grants)]
