"""A robot that does as a test says, and is never kinder than a device."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout
from rcp_kernel.model import MOVING, Resource, kind_of
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress, check_fence

__all__ = ["Behaviour", "ScriptedRobot", "Take", "scripted"]

Behaviour = Callable[[Any, Progress], Awaitable[Any]]
"""What a command does: takes its input, returns its output when the robot has done it."""
Take = Callable[[Any], Awaitable[Any]]
"""What a write does: returns the value now in force, None if it is the one written."""


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scripted robot has nothing to configure."""


class ScriptedRobot(BaseBackend):
    """Has the resources that a test gives it, and does what the test says; notes what reaches it.

    A command without a behaviour of its own runs until `release` is set, and returns its input.
    As with a device, every answer takes at least a turn of the loop; what moves goes on until it
    is commanded to rest, stopped, or done; nothing gets through while the link is `lost`, and what
    runs then ends with the link; and `motion` says what is so, not what was asked for.
    """

    def __init__(
        self,
        host: Host,
        *resources: Resource,
        values: Mapping[str, Any] | None = None,
        behaviours: Mapping[str, Behaviour] | None = None,
    ) -> None:
        self.host = host
        self.values = dict(values or {})
        """What it answers when it is read; a write changes it."""
        self.behaviours = dict(behaviours or {})
        self.takes: dict[str, Take] = {}
        """What a write does beyond being noted, by name."""
        self.lazy: dict[str, Any] = {}
        """What it publishes only once somebody watches."""
        self.delay = 0.0
        """Seconds that each answer takes."""
        self.lost = ""
        """Why nothing gets through to it; empty while it is reached."""
        self.obeys = True
        """Whether it comes to rest when it is told to."""
        self.fail_writes = 0
        """How many of the next writes it refuses."""
        self.fail_halts = 0
        """How many of the next stops it does not hear."""
        self.release = asyncio.Event()
        """Lets commands without a behaviour come to their end."""
        self.started: asyncio.Queue[Any] = asyncio.Queue()
        """The inputs of the actions that began, for tests that wait for one."""
        self.stopped: asyncio.Queue[str] = asyncio.Queue()
        """The names of those whose cancellation reached it."""
        self.writes: list[tuple[str, Any]] = []
        self.ran: list[tuple[str, Any]] = []
        """The commands that reached it, refused ones too."""
        self.watched: list[tuple[str, float | None]] = []
        self.left: list[tuple[str, float | None]] = []
        self.halts = 0
        self.moving: set[str] = set()
        """Names of what moves it: actuators, and actions under way."""
        self._resources: dict[str, Resource] = {}
        self._runs: list[_Run] = []
        self.add(*resources)

    def add(self, *resources: Resource) -> None:
        """Put resources into the tree, or replace them."""
        self._resources.update((one.name, one) for one in resources)
        self.host.declare(*resources)

    def remove(self, *names: str) -> None:
        """Take resources out of the tree."""
        self.host.withdraw(*names)
        for name in names:
            self._resources.pop(name, None)
            self.moving.discard(name)

    def measure(self, name: str, value: Any, timestamp: int | None = None) -> None:
        """Publish a value, and keep it for those who read."""
        self.values[name] = value
        self.host.publish(name, value, timestamp)

    def lose(self, why: str = "no message received for 4.2 s") -> None:
        """Cut the link: what runs ends, and nobody knows whether the robot moves."""
        self.lost = why
        for run in self._runs:
            run.end(AdapterUnavailable(why))

    def find(self) -> None:
        """Mend the link."""
        self.lost = ""
        for robot in dict.fromkeys(one.robot for one in self._resources.values()):
            self.host.link_restored(robot)

    async def read(self, name: str) -> Any:
        """Answer with a value that the test gave."""
        await self.reach()
        return self.values[name] if name in self.values else await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        """Take a value; an actuator moves from now on, unless it is commanded to rest."""
        await self.reach()
        check_fence()
        if self.fail_writes:
            self.fail_writes -= 1
            raise DeviceRejected("busy")
        self.writes.append((name, value))
        force = await self.takes[name](value) if name in self.takes else None
        self.values[name] = value if force is None else force
        resource = self._resources.get(name)
        if resource is not None and _moves(resource):
            if value != resource.safe:
                self.moving.add(name)
            elif self.obeys:
                self.moving.discard(name)
        return force

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Do as the behaviour says, until it is done, cancelled, stopped or out of reach."""
        await self.reach()
        check_fence()
        self.ran.append((name, value))
        resource = self._resources.get(name)
        moves = resource is not None and _moves(resource)
        if moves:
            self.moving.add(name)
        if name.startswith("action/"):
            self.started.put_nowait(value)
        run = _Run(name)
        self._runs.append(run)
        try:
            result = await self.behaviours.get(name, self.wait)(value, progress)
        except asyncio.CancelledError:
            if run.ended_itself() and run.why is not None:
                raise run.why from None
            self.stopped.put_nowait(name)
            if self.lost:
                raise AdapterUnavailable(self.lost) from None
            raise
        finally:
            self._runs.remove(run)
            run.forget()
            if self.obeys and not self.lost:
                self.moving.discard(name)
        return result if resource is None or resource.output is not None else None

    async def wait(self, value: Any, progress: Progress) -> Any:
        """Go on until released, as a command does that has no behaviour of its own."""
        await self.release.wait()
        return value

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[None]:
        """Note who watches what."""
        return self._watching(name, rate)

    @asynccontextmanager
    async def _watching(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        self.watched.append((name, rate))
        if name in self.lazy:
            self.host.publish(name, self.lazy[name])
        yield
        self.left.append((name, rate))

    async def halt(self) -> None:
        """Come to rest, if it hears the stop and obeys it."""
        await self._halt(None)

    async def halt_robot(self, robot: str) -> None:
        """Bring one of several to rest."""
        await self._halt(robot)

    def motion(self, robot: str | None) -> MotionState | None:
        """Tell what moves; nothing is known while the link is lost."""
        if self.lost:
            return MotionState(None, self.lost)
        moving = sorted(self._moving(robot))
        return MotionState(not moving, f"{', '.join(moving)}: under way" if moving else "")

    async def reach(self) -> None:
        """Take the time that an answer takes, and refuse while the link is lost."""
        await asyncio.sleep(self.delay)
        if self.lost:
            raise AdapterUnavailable(self.lost)

    async def _halt(self, robot: str | None) -> None:
        self.halts += 1
        await self.reach()
        if self.fail_halts:
            self.fail_halts -= 1
            raise DeviceRejected("did not hear")
        moving = self._moving(robot)
        if not self.obeys and moving:
            raise DeviceTimeout(f"{', '.join(sorted(moving))}: still under way")
        for run in self._runs:
            if run.name in moving:
                run.end(DeviceRejected("stopped"))
        self.moving -= moving

    def _moving(self, robot: str | None) -> set[str]:
        if robot is None:
            return set(self.moving)
        return {name for name in self.moving if self._resources[name].robot == robot}


class _Run:
    """A command under way, which the robot itself may end: it was stopped, or lost its link."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.why: Exception | None = None
        self._task = asyncio.current_task()

    def end(self, why: Exception) -> None:
        """Have it fail."""
        if self.why is None and self._task is not None:
            self.why = why
            self._task.cancel()

    def ended_itself(self) -> bool:
        """Tell whether nobody else cancelled it."""
        return self.why is not None and self._task is not None and not self._task.uncancel()

    def forget(self) -> None:
        """Let go of the task, which keeps an error whose traceback would keep it."""
        self._task = self.why = None


def _moves(resource: Resource) -> bool:
    return kind_of(resource.name) in MOVING if resource.moves is None else resource.moves


def scripted(make: Callable[[Host], BaseBackend], name: str = "robot") -> BackendKind:
    """Return the kind of robot that a test makes, for `serve` and `serve_backend`."""

    @asynccontextmanager
    async def open_robot(_config: NoOptions, host: Host) -> AsyncGenerator[BaseBackend]:
        yield make(host)

    return BackendKind(name, NoOptions, open_robot)
