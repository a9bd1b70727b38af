"""Containment of plugins that raise `SystemExit` or `KeyboardInterrupt`.

Both pass every `except Exception`, and asyncio lets them escape the event loop. They are therefore
converted to ordinary errors where plugins are called; if one still leaves the loop (from a plugin's
own task or timer), whoever runs the loop has to enter it again, as `rcpd` does.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Generator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from typing import Any

from rcp_kernel.spi import (
    Backend,
    FrameWatch,
    MotionState,
    Progress,
    RobotLease,
    RobotLeaseRequest,
    RobotLink,
    Watchdog,
)

__all__ = [
    "ContainedBackend",
    "PluginExit",
    "call_contained",
    "contained",
]


class PluginExit(RuntimeError):
    """A plugin tried to end the process."""


_ORDINARY = (Exception, asyncio.CancelledError, GeneratorExit)


def _plugin_exit(error: BaseException) -> PluginExit:
    what = f"{type(error).__name__}({', '.join(map(str, error.args))})"
    return PluginExit(f"the plugin raised {what}; the gateway contained it and goes on")


@contextmanager
def contained() -> Generator[None]:
    """Turn whatever would end the process into an ordinary error.

    :raises PluginExit: it would have.
    """
    try:
        yield
    except _ORDINARY:
        raise
    except BaseException as error:
        raise _plugin_exit(error) from error


def call_contained(function: Callable[..., object], *args: Any) -> None:
    """Call a function as in `contained`, which costs 5,000 instructions.

    :raises PluginExit: the call would have ended the process.
    """
    try:
        function(*args)
    except _ORDINARY:
        raise
    except BaseException as error:
        raise _plugin_exit(error) from error


class ContainedBackend:
    """A plugin's backend as the kernel calls it.

    Hot methods have an explicit `try`: a context manager costs 5,000 instructions.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.on_loss = backend.on_loss
        # Absent in backends that do not derive from `BaseBackend`.
        self.has_gateways: bool = getattr(backend, "has_gateways", False)

    @property
    def inner(self) -> Backend:
        """The plugin's own object, for tests that inspect it."""
        return self._backend

    def __getattr__(self, name: str) -> Any:
        """Return other attributes of the backend, which its own tests and adapters may use."""
        return getattr(self._backend, name)

    async def read(self, name: str) -> Any:
        """Ask the robot for a value."""
        try:
            return await self._backend.read(name)
        except _ORDINARY:
            raise
        except BaseException as error:
            raise _plugin_exit(error) from error

    def frames_of(self, name: str) -> Sequence[str]:
        """Ask for the frames that the robot's own gateway listed."""
        with contained():
            return self._backend.frames_of(name)

    def watch_in_frame(self, name: str, watch: FrameWatch) -> Callable[[], None]:
        """Have the robot's own gateway send values in a frame."""
        with contained():
            return self._backend.watch_in_frame(name, watch)

    async def read_in_frame(self, name: str, frame: str) -> Any:
        """Ask the robot's own gateway for a value in a frame."""
        with contained():
            return await self._backend.read_in_frame(name, frame)

    async def write(self, name: str, value: Any) -> Any:
        """Write a value."""
        try:
            return await self._backend.write(name, value)
        except _ORDINARY:
            raise
        except BaseException as error:
            raise _plugin_exit(error) from error

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Write several values as one."""
        with contained():
            return await self._backend.write_together(values)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or a service."""
        try:
            return await self._backend.execute(name, value, progress)
        except _ORDINARY:
            raise
        except BaseException as error:
            raise _plugin_exit(error) from error

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a dry run of what would be refused now."""
        with contained():
            self._backend.foresee(name, value)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Publish a value while entered."""
        return self._watch(name, rate)

    @asynccontextmanager
    async def _watch(self, name: str, rate: float | None) -> AsyncGenerator[object]:
        with contained():
            async with self._backend.watch(name, rate) as watching:
                yield watching

    async def halt(self) -> None:
        """Bring all to rest."""
        with contained():
            await self._backend.halt()

    async def halt_robot(self, robot: str) -> None:
        """Bring one robot to rest."""
        with contained():
            await self._backend.halt_robot(robot)

    def motion(self, robot: str | None) -> MotionState | None:
        """Report whether a robot is at rest."""
        with contained():
            return self._backend.motion(robot)

    def hold_stop(self, robot: str | None) -> None:
        """Send again what keeps a robot stopped."""
        with contained():
            self._backend.hold_stop(robot)

    async def hold(self, robot: str | None) -> None:
        """Bring a robot to rest without an e-stop."""
        with contained():
            await self._backend.hold(robot)

    async def recover(self, robot: str | None) -> str:
        """Apply the policy after a lost link."""
        with contained():
            return await self._backend.recover(robot)

    async def reset_estop(self, robot: str | None) -> None:
        """Ask a robot's own gateway to reset its e-stop."""
        with contained():
            await self._backend.reset_estop(robot)

    async def lease(self, robot: str, request: RobotLeaseRequest) -> RobotLease:
        """Ask a robot's own gateway for a lease."""
        with contained():
            return await self._backend.lease(robot, request)

    def watchdogs(self) -> Sequence[Watchdog]:
        """List what stops the robot when the gateway falls silent."""
        with contained():
            return self._backend.watchdogs()

    def robot_link(self, robot: str) -> RobotLink | None:
        """Report what the link with a robot's own gateway carries."""
        with contained():
            return self._backend.robot_link(robot)
