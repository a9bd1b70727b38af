"""A `Host` that records what a backend does with it, and passes everything on."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcp_kernel.errors import RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import (
    Anchor,
    FrameTree,
    Host,
    OwnLeases,
    Publication,
    RobotFacts,
    StopPlan,
)
from rcp_protocol.timeouts import timeout

__all__ = ["Recorder"]


class Recorder:
    """Stands between a backend and the kernel."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self.tenant = host.tenant
        self.robot = host.robot
        self.resources: dict[str, Resource] = {}
        """The declared resources, by name."""
        self.published: dict[str, int] = {}
        """Number of published values, by name."""
        self.wrong_thread: set[str] = set()
        """Methods that were called from another thread than the event loop's, and must not be."""
        self.plans: dict[str, StopPlan] = {}
        """The plans of the guard process, by name."""
        self._thread = threading.get_ident()
        self._waiting: list[tuple[str, asyncio.Event]] = []

    async def publishes(self, name: str, within: float) -> bool:
        """Wait for the next value of a name; return whether one arrived within `within` seconds."""
        waiter = name, asyncio.Event()
        self._waiting.append(waiter)
        try:
            async with timeout(within):
                await waiter[1].wait()
        except TimeoutError:
            return False
        finally:
            self._waiting.remove(waiter)
        return True

    def _note(self, name: str) -> None:
        self.published[name] = self.published.get(name, 0) + 1
        for wanted, event in self._waiting:
            if wanted == name:
                event.set()

    def _check(self, method: str) -> None:
        if threading.get_ident() != self._thread:
            self.wrong_thread.add(method)

    def declare(self, *resources: Resource) -> None:
        """Note and pass on."""
        self._check("declare")
        self._host.declare(*resources)
        self.resources.update({resource.name: resource for resource in resources})

    def withdraw(self, *names: str) -> None:
        """Note and pass on."""
        self._check("withdraw")
        self._host.withdraw(*names)
        for name in names:
            self.resources.pop(name, None)

    def publish(self, name: str, value: Any, timestamp: int | None = None) -> None:
        """Note and pass on."""
        self._check("publish")
        self._note(name)
        self._host.publish(name, value, timestamp)

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        """Note and pass on; from any thread."""
        self._host.publish_batch(batch)
        self._host.call_soon(lambda: [self._note(item.name) for item in batch])

    def call_soon(self, function: Callable[..., object], *args: Any) -> None:
        """Pass on."""
        self._host.call_soon(function, *args)

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        """Pass on."""
        self._check("report")
        self._host.report(detail, down=down, robot=robot)

    def link_restored(self, robot: str | None = None) -> None:
        """Pass on."""
        self._check("link_restored")
        self._host.link_restored(robot)

    def is_latched(self, robot: str | None = None) -> bool:
        """Pass on."""
        self._check("is_latched")
        return self._host.is_latched(robot)

    def guard(self, name: str, plan: StopPlan | None) -> None:
        """Note and pass on."""
        self._check("guard")
        self.plans.pop(name, None)
        if plan is not None:
            self.plans[name] = plan
        self._host.guard(name, plan)

    def own_estop(
        self, robot: str, state: Mapping[str, Any] | None, *, reset: bool = False
    ) -> None:
        """Do nothing: no robot has a gateway of its own."""

    def own_leases(self, robot: str, leases: OwnLeases | None) -> None:
        """Do nothing: no robot has a gateway of its own."""

    def refused(self, error: RcpError, *, count: int = 1) -> None:
        """Pass on."""
        self._check("refused")
        self._host.refused(error, count=count)

    def anchor(self, anchor: Anchor | None, robot: str | None = None) -> None:
        """Pass on."""
        self._check("anchor")
        self._host.anchor(anchor, robot)

    def transforms(self, tree: FrameTree, robot: str | None = None) -> None:
        """Pass on."""
        self._check("transforms")
        self._host.transforms(tree, robot)

    def describe(self, facts: RobotFacts, robot: str | None = None) -> None:
        """Pass on."""
        self._check("describe")
        self._host.describe(facts, robot)

    def discovering(self, *, active: bool) -> None:
        """Pass on."""
        self._check("discovering")
        self._host.discovering(active=active)
