"""A robot whose behaviour a test defines, as unforgiving as a real device."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout, RcpError
from rcp_kernel.model import MOVING, Resource, kind_of
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress, check_fence

__all__ = ["Behaviour", "ScriptedRobot", "Take", "scripted"]

Behaviour = Callable[[Any, Progress], Awaitable[Any]]
"""The behaviour of a command: takes its input, returns its output when it is completed."""
Take = Callable[[Any], Awaitable[Any]]
"""The behaviour of a write: returns the value now in force; None if it is the written one."""


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scripted robot has no configuration."""


class ScriptedRobot(BaseBackend):
    """Has the resources and behaviours that a test gives it, and records what reaches it.

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
        """Values that reads return; a write changes them."""
        self.behaviours = dict(behaviours or {})
        self.takes: dict[str, Take] = {}
        """Behaviours of writes, by name."""
        self.lazy: dict[str, Any] = {}
        """Values that it publishes only while watched."""
        self.delay = 0.0
        """Delay of each response, in seconds."""
        self.lost = ""
        """Why the link is lost; empty while it is up."""
        self.obeys = True
        """Whether it comes to rest when commanded to."""
        self.fail_writes = 0
        """Number of writes that it refuses next."""
        self.fail_halts = 0
        """Number of stops that it does not receive next."""
        self.release = asyncio.Event()
        """Lets commands without a behaviour complete."""
        self.started: asyncio.Queue[Any] = asyncio.Queue()
        """The inputs of started actions, for tests that wait for them."""
        self.stopped: asyncio.Queue[str] = asyncio.Queue()
        """The names of actions whose cancellation reached it."""
        self.writes: list[tuple[str, Any]] = []
        self.together: list[dict[str, Any]] = []
        """The values that were written as one."""
        self.ran: list[tuple[str, Any]] = []
        """The commands that reached it, including refused ones."""
        self.watched: list[tuple[str, float | None]] = []
        self.left: list[tuple[str, float | None]] = []
        self.halts = 0
        self.moving: set[str] = set()
        """Names of actuators and running actions that move it."""
        self._resources: dict[str, Resource] = {}
        self._runs: list[_Run] = []
        self.add(*resources)

    def add(self, *resources: Resource) -> None:
        """Put resources into the tree, or replace them."""
        self._resources.update((one.name, one) for one in resources)
        self.host.declare(*resources)

    def remove(self, *names: str) -> None:
        """Remove resources from the tree."""
        self.host.withdraw(*names)
        for name in names:
            self._resources.pop(name, None)
            self.moving.discard(name)

    def measure(self, name: str, value: Any, timestamp: int | None = None) -> None:
        """Publish a value, and return it to reads."""
        self.values[name] = value
        self.host.publish(name, value, timestamp)

    def lose(self, why: str = "no message received for 4.2 s") -> None:
        """Cut the link: running commands end, and the robot's motion is unknown."""
        self.lost = why
        for run in self._runs:
            run.end(AdapterUnavailable(why))

    def find(self) -> None:
        """Restore the link."""
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
        self._bring_into_force(name, value, force)
        return force

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Take several values as one, if all of `takes` do; what is refused changes nothing."""
        await self.reach()
        check_fence()
        forces: dict[str, Any] = {}
        for name, value in values.items():
            try:
                forces[name] = await self.takes[name](value) if name in self.takes else None
            except RcpError as error:
                error.path = name
                raise
        check_fence()
        self.together.append(dict(values))
        for name, value in values.items():
            self._bring_into_force(name, value, forces[name])
        return {name: force for name, force in forces.items() if force is not None}

    def _bring_into_force(self, name: str, value: Any, force: Any) -> None:
        self.values[name] = value if force is None else force
        resource = self._resources.get(name)
        if resource is not None and _moves(resource):
            if value != resource.safe:
                self.moving.add(name)
            elif self.obeys:
                self.moving.discard(name)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run the behaviour until it is completed, cancelled, stopped or the link is lost."""
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
        """Run until released: the behaviour of a command without one of its own."""
        await self.release.wait()
        return value

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[None]:
        """Record which resources are watched."""
        return self._watching(name, rate)

    @asynccontextmanager
    async def _watching(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        self.watched.append((name, rate))
        if name in self.lazy:
            self.host.publish(name, self.lazy[name])
        yield
        self.left.append((name, rate))

    async def halt(self) -> None:
        """Come to rest, if the stop reaches it and it obeys."""
        await self._halt(None)

    async def halt_robot(self, robot: str) -> None:
        """Bring one of several robots to rest."""
        await self._halt(robot)

    def motion(self, robot: str | None) -> MotionState | None:
        """Report the motion; unknown while the link is lost."""
        if self.lost:
            return MotionState(None, self.lost)
        moving = sorted(self._moving(robot))
        return MotionState(not moving, f"{', '.join(moving)}: under way" if moving else "")

    async def reach(self) -> None:
        """Wait for the response delay, and refuse while the link is lost."""
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
    """A running command, which the robot may end itself because of a stop or a lost link."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.why: Exception | None = None
        self._task = asyncio.current_task()

    def end(self, why: Exception) -> None:
        """Let it fail."""
        if self.why is None and self._task is not None:
            self.why = why
            self._task.cancel()

    def ended_itself(self) -> bool:
        """Return whether the robot ended it, not a cancellation."""
        return self.why is not None and self._task is not None and not self._task.uncancel()

    def forget(self) -> None:
        """Drop the task, to avoid a reference cycle through the traceback of its error."""
        self._task = self.why = None


def _moves(resource: Resource) -> bool:
    return kind_of(resource.name) in MOVING if resource.moves is None else resource.moves


def scripted(make: Callable[[Host], BaseBackend], name: str = "robot") -> BackendKind:
    """Return the kind of robot that a test makes, for `serve` and `serve_backend`."""

    @asynccontextmanager
    async def open_robot(_config: NoOptions, host: Host) -> AsyncGenerator[BaseBackend]:
        yield make(host)

    return BackendKind(name, NoOptions, open_robot)
