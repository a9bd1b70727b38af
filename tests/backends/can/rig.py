"""A CAN backend on the bench: a host that records, and a second node on the virtual bus."""

from __future__ import annotations

import asyncio
import itertools
import threading
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from typing import Any, Self

import anyio
import can
import msgspec

from rcp_can import CanConfig, open_can
from rcp_can.sim import Bench, Twin, make_twin
from rcp_kernel.model import Resource
from rcp_kernel.spi import Anchor, FrameTree, Publication, RobotFacts, StopPlan
from rcp_kernel.values import to_plain, value_type

_NUMBERS = itertools.count()


def channel() -> str:
    """Return the name of a virtual bus that nobody has used."""
    return f"test-{next(_NUMBERS)}"


class RecordingHost:
    """Keeps what a backend declares, publishes and reports; checks every value on the way."""

    def __init__(self) -> None:
        self.tenant = "alpha"
        self.robot: str | None = None
        self.resources: dict[str, Resource] = {}
        self.samples: dict[str, list[Any]] = {}
        self.facts: dict[str | None, RobotFacts] = {}
        self.reports: list[str | None] = []
        self.latched = False
        self.restored: list[str | None] = []
        self.on_restored: Callable[[], object] = lambda: None
        self.plans: dict[str, StopPlan | None] = {}
        self.published = anyio.Event()

    def declare(self, *declared: Resource) -> None:
        for resource in declared:
            for type_ in (resource.value, resource.input, resource.output, resource.feedback):
                if type_ is not None:
                    assert value_type(type_).schema
            self.resources[resource.name] = resource

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
        value = value.decode() if hasattr(value, "decode") else value
        value_type(self.resources[name].value).check(value)
        self.samples.setdefault(name, []).append(value)
        self._tell()

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        for item in batch:
            self.publish(item.name, item.value, item.timestamp)

    def call_soon(self, function: Callable[..., object], *args: Any) -> None:
        asyncio.get_running_loop().call_soon_threadsafe(function, *args)

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        self.reports.append(detail)
        self._tell()

    def link_restored(self, robot: str | None = None) -> None:
        self.restored.append(robot)
        self.on_restored()

    def is_latched(self, robot: str | None = None) -> bool:
        return self.latched

    def guard(self, name: str, plan: StopPlan | None) -> None:
        self.plans[name] = plan

    def _tell(self) -> None:
        self.published.set()
        self.published = anyio.Event()

    def last(self, name: str) -> Any:
        return self.samples[name][-1]

    def events(self, name: str) -> list[Any]:
        return self.samples.get(name, [])

    async def until(self, holds: Callable[[], object], seconds: float = 60.0) -> None:
        with anyio.fail_after(seconds):
            while not holds():
                await self.published.wait()

    async def published_as(self, name: str, seconds: float = 60.0, **facts: Any) -> Any:
        """Wait until the newest value has these facts, and return it."""

        def holds() -> bool:
            return name in self.samples and all(
                getattr(self.last(name), key) == value for key, value in facts.items()
            )

        await self.until(holds, seconds)
        return self.last(name)


class Rig:
    """An open backend and a host that saw everything."""

    def __init__(self, backend: Any, host: RecordingHost) -> None:
        self.backend, self.host = backend, host
        self.feedback: list[tuple[Any, float | None]] = []

    def progress(self, feedback: Any = None, *, fraction: float | None = None) -> None:
        self.feedback.append((feedback, fraction))

    def typed(self, name: str, plain: Any) -> Any:
        """Decode what a client would send."""
        resource = self.host.resources[name]
        wanted = resource.value if resource.value is not None else resource.input
        return plain if wanted is None else value_type(wanted).convert(plain)

    async def write(self, name: str, plain: Any) -> Any:
        return await self.backend.write(name, self.typed(name, plain))

    def execute(self, name: str, plain: Any = None) -> Awaitable[Any]:
        value = None if plain is None else self.typed(name, plain)
        return self.backend.execute(name, value, self.progress)

    async def ran(self, name: str, plain: Any = None, seconds: float = 60.0) -> Any:
        with anyio.fail_after(seconds):
            return to_plain(await self.execute(name, plain))


@asynccontextmanager
async def opened(config: dict[str, Any]) -> AsyncGenerator[Rig]:
    """Open a backend by its table."""
    host = RecordingHost()
    async with open_can(msgspec.convert(config, CanConfig), host) as backend:
        yield Rig(backend, host)


class Node:
    """Another node on a virtual bus: sends what it is told to, keeps what it hears."""

    def __init__(self, channel: str, *, fd: bool = False) -> None:
        protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self.bus = can.Bus(channel, "virtual", protocol=protocol, ignore_config=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bus.shutdown()

    def send(self, identifier: int, data: bytes = b"", **more: Any) -> None:
        more.setdefault("is_extended_id", identifier > 0x7FF)
        self.bus.send(can.Message(arbitration_id=identifier, data=data, **more))

    def bus_off(self) -> None:
        self.send(0x40, bytes(8), is_error_frame=True, is_extended_id=False)

    async def hears(self, wanted: Callable[[can.Message], object], seconds: float = 60.0) -> Any:
        """Wait for the first frame that is wanted."""
        with anyio.fail_after(seconds):
            while True:
                message = await anyio.to_thread.run_sync(self.bus.recv, 0.05)
                if message is not None and wanted(message):
                    return message


PATIENT: dict[str, Any] = {"watchdog": 10.0, "options": {"heartbeat": 300}}
"""Of a CiA 402 drive, in tests that are not about heartbeats: it waits 10 s for the gateway's, which waits
for three of the drive's. On a busy machine either is late by more than a robot would allow."""

MOTORS: dict[str, dict[str, Any]] = {
    "cia402": {"node": 5, **PATIENT},
    "odrive": {"node": 1},
    "mit": {"node": 1},
    "tmotor": {"node": 2, "options": {"model": "AK80-9"}},
    "damiao": {"node": 3},
    "cybergear": {"node": 4},
    "moteus": {"node": 1},
    "vesc": {"node": 7},
}
"""A motor of each profile, as its table of the configuration."""


OTHERS: dict[str, dict[str, Any]] = {
    "dronecan": {"node": 20, "options": {"index": 1, "command_timeout": 0.5}}
}
"""What tests of all motors leave out, because it drives as VESCs do."""


def with_keys(profile: str, keys: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a profile's motor with more keys, and with options beside its own."""
    usual = (MOTORS | OTHERS)[profile]
    options = {**usual.get("options", {}), **keys.get("options", {})}
    return {**usual, **keys, **({"options": options} if options else {})}


class Motor(Rig):
    """A backend with one motor, 'm', and the twin that it drives."""

    def __init__(self, rig: Rig, bench: Bench, channel: str) -> None:
        super().__init__(rig.backend, rig.host)
        self.bench, self.twin, self.channel = bench, bench.twins[0], channel
        self.axis = self.backend.axes["m"]

    async def until(self, holds: Callable[[], object], seconds: float = 60.0) -> None:
        with anyio.fail_after(seconds):
            while not holds():  # noqa: ASYNC110  # a twin lives in a thread that tells nobody
                await asyncio.sleep(0.002)

    async def ordered(self, function: Callable[[], object]) -> None:
        """Do something to the twin in its own thread."""
        done = asyncio.Event()
        loop = asyncio.get_running_loop()

        def do() -> None:
            function()
            loop.call_soon_threadsafe(done.set)

        self.bench.order(do)
        with anyio.fail_after(60):
            await done.wait()

    @contextmanager
    def jammed(self) -> Generator[None]:
        """Let the bus take no frames while entered: each waits until it does again."""
        gate = threading.Event()
        bus = self.backend.buses["can0"].wire.interface
        real = bus.send

        def send(message: can.Message, timeout: float | None = None) -> None:
            gate.wait(60)
            real(message, timeout)

        bus.send = send
        try:
            yield
        finally:
            gate.set()
            bus.send = real

    @contextmanager
    def unread(self) -> Generator[None]:
        """Leave received frames in the interface while entered; read them one by one afterwards."""
        gate = threading.Event()
        bus = self.backend.buses["can0"].wire.interface
        real, loop = bus.recv, asyncio.get_running_loop()

        def receive(timeout: float | None = None) -> can.Message | None:
            gate.wait(60)
            taken = threading.Event()
            loop.call_soon_threadsafe(taken.set)
            taken.wait(1)  # until the event loop has taken the one before
            return real(timeout)

        bus.recv = receive
        try:
            yield
        finally:
            gate.set()

    async def enable(self) -> None:
        await self.ran("service/m/enable")

    def faults(self, *, active: bool = True) -> list[str]:
        return [e.fault for e in self.host.events("event/m/fault") if e.active is active]


@asynccontextmanager
async def motor(
    profile: str,
    *,
    bus: dict[str, Any] | None = None,
    twins: Sequence[Twin] = (),
    config: dict[str, Any] | None = None,
    motors: dict[str, Any] | None = None,
    **keys: Any,
) -> AsyncGenerator[Motor]:
    """Run the twin of a profile, and a backend that drives it."""
    name = channel()
    slow = {"timeout": 1.0, "feedback_timeout": 1.0}  # for machines that do much else
    table = {"bus": "can0", "profile": profile, **slow, **with_keys(profile, keys)}
    protocol = can.CanProtocol.CAN_FD if profile == "moteus" else can.CanProtocol.CAN_20
    line = can.Bus(name, "virtual", protocol=protocol, ignore_config=True)
    twin = make_twin(profile, table["node"], **table.get("options", {}))
    line_config = {"interface": "virtual", "channel": name, "restart": 0.02, "statistics": 0.05}
    line_config |= {"fd": profile == "moteus", **(bus or {})}
    whole = {"buses": {"can0": line_config}, "motors": {"m": table, **(motors or {})}}
    whole |= config or {}
    with Bench(line, [twin, *twins]) as bench:
        async with opened(whole) as rig:
            yield Motor(rig, bench, name)
