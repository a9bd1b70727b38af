"""What the tests of the ROS 2 backend share: a host that records, and a peer in its own process."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec

from rcp_kernel.model import Resource
from rcp_kernel.spi import Anchor, FrameTree, Native, Publication, RobotFacts, StopPlan
from rcp_ros2 import Ros2Config, open_ros2
from rcp_ros2.backend import Ros2Backend

BOUND = 60.0  # s that any wait of a test may take: discovery on a busy machine takes long
_DOMAINS = (*range(1, 101), *range(215, 232))
"""Those whose ports the system gives to nobody by itself."""
_ENDS = 20.0  # s that a peer has to leave the graph in good order
_UNMAPPED = 10.0  # s within which a process on a busy machine has mapped what it has made


def fresh_domain() -> int:
    """Return a domain that no other test on this machine uses, of this run or of another.

    It is claimed by the name of a socket, which goes with this process, however it ends.
    """
    first = os.getpid() % len(_DOMAINS)  # what another run has just left may still linger
    for domain in (*_DOMAINS[first:], *_DOMAINS[:first]):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0rcp-gateway-tests-ros-domain-{domain}")
        except OSError:
            claim.close()
        else:
            claim.detach()
            _clear()
            return domain
    raise AssertionError("every ROS domain is in use by tests")


def _clear() -> None:
    """Remove the shared memory of killed processes: Fast DDS may wait for ever in front of it.

    Some of it, such as port 7000, is shared by the processes of all domains. What somebody has made
    just now may not be mapped yet: without what is shared with it, it would be heard by nobody.
    """
    recent = time.time() - _UNMAPPED
    found = [file for file in Path("/dev/shm").glob("*fastdds_*") if _made(file) < recent]
    maps = ""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            maps += process.joinpath("maps").read_text()
    used = set(re.findall(r"/dev/shm/(\S*fastdds_\S+)", maps))
    for file in found:
        segment = file.name.removeprefix("sem.").removesuffix("_mutex").removesuffix("_el")
        if used.isdisjoint((segment, f"sem.{segment}_mutex")):
            file.unlink(missing_ok=True)


def _made(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except FileNotFoundError:
        return time.time()


class Robot:
    """A host, the backend on it, and all that was said to the host."""

    tenant = "alpha"
    robot = None

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.resources: dict[str, Resource] = {}
        self.samples: list[tuple[str, Any, int | None]] = []
        self.reports: list[str | None] = []
        self.latched: set[str | None] = set()
        self.restored: list[str | None] = []
        self.plans: dict[str, StopPlan] = {}
        self.facts: dict[str | None, RobotFacts] = {}
        self.backend: Ros2Backend
        self._changed = asyncio.Event()

    def declare(self, *resources: Resource) -> None:
        self.resources |= {r.name: r for r in resources}
        self._changed.set()

    def withdraw(self, *names: str) -> None:
        for name in names:
            self.resources.pop(name, None)
        self._changed.set()

    def publish(self, name: str, value: Any, timestamp: int | None = None) -> None:
        assert asyncio.get_running_loop() is self.loop
        self.samples.append((name, value, timestamp))
        self._changed.set()

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        for item in batch:
            self.call_soon(self.publish, item.name, item.value, item.timestamp)

    def call_soon(self, function: Callable[..., object], *args: Any) -> None:
        self.loop.call_soon_threadsafe(function, *args)

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        self.reports.append(detail)
        self._changed.set()

    def link_restored(self, robot: str | None = None) -> None:
        self.restored.append(robot)
        self._changed.set()

    def is_latched(self, robot: str | None = None) -> bool:
        return robot in self.latched

    def guard(self, name: str, plan: StopPlan | None) -> None:
        self.plans.pop(name, None)
        if plan is not None:
            self.plans[name] = plan

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

    def discovering(self, *, active: bool) -> None:
        pass

    async def until(self, holds: Callable[[], Any], seconds: float = BOUND) -> Any:
        """Wait until something holds of what the host was told."""
        async with asyncio.timeout(seconds):
            while not (found := holds()):
                self._changed.clear()
                await self._changed.wait()
        return found

    async def until_async(
        self,
        look: Callable[[], Awaitable[Any]],
        holds: Callable[[Any], Any],
        seconds: float = BOUND,
    ) -> Any:
        """Do something again until what it returns is right."""
        async with asyncio.timeout(seconds):
            while not holds(found := await look()):  # noqa: ASYNC110 - nothing tells of it
                await asyncio.sleep(0.02)
        return found

    def of(self, name: str) -> list[Any]:
        """Return the values published under a name, decoded."""
        return [
            value.decode() if isinstance(value, Native) else value
            for known, value, _ in self.samples
            if known == name
        ]

    async def first(self, name: str, seconds: float = BOUND) -> Any:
        """Wait for the first value of a name."""
        await self.until(lambda: any(known == name for known, _, _ in self.samples), seconds)
        return self.of(name)[0]

    def input(self, name: str, plain: Any) -> Any:
        """Make the typed input (or value) of a resource."""
        resource = self.resources[name]
        return msgspec.convert(plain, resource.input or resource.value)

    async def read(self, name: str) -> Any:
        """Read a value; it may come with its time."""
        found = await self.backend.read(name)
        return found.value if isinstance(found, Publication) else found

    async def execute(self, name: str, plain: Any = None) -> Any:
        """Run an action or service without looking at its progress."""
        value = None if plain is None else self.input(name, plain)
        return await self.backend.execute(name, value, ignore)


def ignore(feedback: Any = None, *, fraction: float | None = None) -> None:
    """Look away from the progress of a command."""


@asynccontextmanager
async def robot_of(domain: int, **config: Any) -> AsyncIterator[Robot]:
    """Open a backend on a recording host."""
    robot = Robot()
    decoded = msgspec.convert({"domain_id": domain, **config}, Ros2Config)
    async with open_ros2(decoded, robot) as backend:
        robot.backend = backend
        with suppress(TimeoutError):  # discovery takes 3 s now and then
            await asyncio.wait_for(backend.catalog.complete.wait(), decoded.grace)
        yield robot


class Peer:
    """The other side, in a process of its own."""

    script = "peer.py"

    def __init__(self, domain: int, *args: str, shared_memory: bool = True) -> None:
        """Without shared memory a peer that is killed leaves nothing damaged to the one after it."""
        self._environment = {"ROS_DOMAIN_ID": str(domain)}
        if not shared_memory:
            self._environment["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"
        self._args = args
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start it and wait until it offers everything."""
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name(self.script)), *self._args],
            env=os.environ | self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def truth(self) -> dict[str, Any]:
        """Ask how things are with it, past every interface of ROS."""
        return self._ask("truth")

    def refuse(self, parameter: str) -> None:
        """Have it refuse a parameter from now on; an empty name ends that."""
        self._ask(f"refuse {parameter}")

    def withdraw(self) -> None:
        """Have it offer its slow service no more."""
        self._ask("withdraw")

    def retire(self) -> None:
        """Have it serve its action no more."""
        self._ask("retire")

    def _ask(self, line: str) -> Any:
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    @property
    def runs(self) -> bool:
        """Whether it lives."""
        return self._process is not None

    def kill(self) -> None:
        """Kill it as a crash would: nobody in the graph is told."""
        assert self._process is not None
        self._process.send_signal(signal.SIGKILL)
        self._reap()

    def freeze(self) -> None:
        """Stop its process, as a machine does that hangs."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let its process go on."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def stop(self) -> None:
        """Have it leave the graph in good order."""
        if self._process is not None and self._process.poll() is None:
            assert self._process.stdin is not None
            self._process.stdin.close()
            try:
                self._process.wait(_ENDS)
            except subprocess.TimeoutExpired:
                self._process.kill()
        self._reap()

    def _reap(self) -> None:
        if self._process is not None:
            self._process.wait(BOUND)
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()
            self._process = None


class RobotNodes(Peer):
    """Nodes that follow ROS's conventions, in a process of their own."""

    script = "robot_nodes.py"

    def tell(self, do: str, **order: Any) -> Any:
        """Have it do something; return when it has."""
        return self._ask(json.dumps({"do": do, **order}))


class Fleet(RobotNodes):
    """Rovers, each in a namespace of its own, in one process."""

    script = "rover.py"


class Eyes(RobotNodes):
    """A rover with all that a dashboard draws."""

    script = "seen.py"


class Base(RobotNodes):
    """A driving base with a navigator."""

    script = "base.py"


class Commander(RobotNodes):
    """Somebody else who commands the base."""

    script = "commander.py"


class Wheels(RobotNodes):
    """A rover with the names that ROS 2 robots have in common."""

    script = "wheels.py"


class Jointed(RobotNodes):
    """An arm, or two, with a controller of ros2_control."""

    script = "jointed.py"


class Navigator(RobotNodes):
    """Nav2's controller_server, as far as speed limits go."""

    script = "navigator.py"


class Simulated(RobotNodes):
    """A simulator with a rover in it."""

    script = "simulated.py"
