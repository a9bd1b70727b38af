"""A rover on the bench: its loop is turned by hand, so that no test waits for real time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import anyio
import pytest

from rcp_kernel.contract.fence import permitted
from rcp_kernel.model import Resource
from rcp_kernel.spi import Anchor, FrameTree, Publication, RobotFacts, StopPlan
from rcp_kernel.values import value_type
from rcp_sim import SimBackend, SimConfig
from rcp_sim.device import Device
from rcp_sim.resources import resources


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class RecordingHost:
    """Keeps what a backend declares, publishes and reports; checks every value on the way."""

    def __init__(self) -> None:
        self.tenant = "alpha"
        self.robot: str | None = None
        self.resources: dict[str, Resource] = {}
        self.samples: dict[str, list[Any]] = {}
        self.stamps: dict[str, list[int | None]] = {}
        self.facts: dict[str | None, RobotFacts] = {}
        self.reports: list[tuple[str | None, bool]] = []
        self.restored = 0
        self.published = anyio.Event()

    def declare(self, *declared: Resource) -> None:
        self.resources |= {resource.name: resource for resource in declared}

    def own_estop(
        self, robot: str, state: Mapping[str, Any] | None, *, reset: bool = False
    ) -> None:
        """Do nothing: no robot has a gateway of its own."""

    def anchor(self, anchor: Anchor | None, robot: str | None = None) -> None:
        pass

    def transforms(self, tree: FrameTree, robot: str | None = None) -> None:
        pass

    def describe(self, facts: RobotFacts, robot: str | None = None) -> None:
        self.facts[robot] = facts

    def withdraw(self, *names: str) -> None:
        for name in names:
            self.resources.pop(name, None)

    def publish(self, name: str, value: Any, timestamp: int | None = None) -> None:
        value_type(self.resources[name].value).check(value)
        self.samples.setdefault(name, []).append(value)
        self.stamps.setdefault(name, []).append(timestamp)
        self.published.set()
        self.published = anyio.Event()

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        for item in batch:
            self.publish(item.name, item.value, item.timestamp)

    def call_soon(self, function: Callable[..., object], *args: Any) -> None:
        asyncio.get_running_loop().call_soon_threadsafe(function, *args)

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        self.reports.append((detail, down))

    def link_restored(self, robot: str | None = None) -> None:
        self.restored += 1

    def is_latched(self, robot: str | None = None) -> bool:
        return False

    def guard(self, name: str, plan: StopPlan | None) -> None:
        """There is no guard process here."""

    def last(self, name: str) -> Any:
        return self.samples[name][-1]

    def count(self, name: str) -> int:
        return len(self.samples.get(name, ()))

    async def until(self, holds: Callable[[], bool]) -> None:
        with anyio.fail_after(60):
            while not holds():
                await self.published.wait()


class Rig:
    """A device and its backend without their clock; never stopped by a gateway."""

    name = "rig"
    stops = 0

    def __init__(self, config: SimConfig) -> None:
        self.config = config
        self.host = RecordingHost()
        self.device = Device(config, self.host)
        self.host.declare(*resources(config))
        self.device.boot()
        self.backend = SimBackend(self.device)
        self.sim = self.device.sim
        self.feedback: list[tuple[Any, float | None]] = []
        self.stamp = 1_800_000_000_000_000_000

    def tick(self, seconds: float | None = None) -> None:
        """Let real time pass, by default one period."""
        for _ in range(1 if seconds is None else round(seconds * self.config.rate)):
            self.stamp += int(1e9 / self.config.rate)
            self.device.tick(self.stamp)

    def progress(self, feedback: Any = None, *, fraction: float | None = None) -> None:
        self.feedback.append((feedback, fraction))

    def typed(self, name: str, plain: Any) -> Any:
        """Decode what a client would send."""
        resource = self.host.resources[name]
        wanted = resource.value if resource.value is not None else resource.input
        return value_type(wanted).convert(plain)

    def execute(self, name: str, plain: Any = None) -> Awaitable[Any]:
        return self.backend.execute(name, self.typed(name, plain), self.progress)

    def write(self, name: str, plain: Any) -> Awaitable[Any]:
        return self.backend.write(name, self.typed(name, plain))

    async def drive(self, v: float = 0.0, w: float = 0.0) -> Any:
        """Write a velocity as for a request, under a permit."""
        with permitted(self, 0):
            return await self.write("actuator/cmd_vel", {"linear": {"x": v}, "angular": {"z": w}})

    async def fault(self, **spec: Any) -> Any:
        injected = await self.execute("service/inject_fault", spec)
        if spec["fault"] == "link_lost":
            self.tick(0.06)
        return injected

    async def settle(self, work: Awaitable[Any], *, seconds: float = 300.0) -> Any:
        """Turn the loop until the work is done, and return its result."""
        return await self.turn(asyncio.ensure_future(work), seconds=seconds)

    async def turn(self, task: asyncio.Future[Any], *, seconds: float = 300.0) -> Any:
        for _ in range(round(seconds * self.config.rate)):
            await asyncio.sleep(0)
            if task.done():
                return task.result()
            self.tick()
        task.cancel()
        raise AssertionError(f"not done within {seconds} s of the rover's time")

    async def begin(self, work: Awaitable[Any], *, seconds: float = 2.0) -> asyncio.Future[Any]:
        """Start the work and let it go on for a while."""
        task = asyncio.ensure_future(work)
        for _ in range(round(seconds * self.config.rate)):
            await asyncio.sleep(0)
            self.tick()
        return task


@pytest.fixture
def make_rig() -> Callable[..., Rig]:
    """Build a rover by configuration keys; coarse maps keep the tests quick."""

    def make(**config: Any) -> Rig:
        return Rig(SimConfig(**{"map_resolution": 0.5, **config}))

    return make


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()


@pytest.fixture
def host() -> RecordingHost:
    return RecordingHost()
