"""The robot of the wire suite: a twin whose reactions are chosen by the tests.

The values sent to it select its behaviour, so that a test needs only the wire; its calls can be
inspected.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import msgspec

from rcp_gateway.testing.wire._resources import BROKEN, arrived, ghost, resources, small
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, NotReady
from rcp_kernel.spi import BackendKind, BaseBackend, Host, Progress

__all__ = ["DEAD", "ROBOT", "Absence", "WireRobot"]


class WireConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The robot's table."""

    small: bool = False
    """Only a level and a limit: a second robot."""


class WireRobot(BaseBackend):
    """One robot."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.values: dict[str, Any] = {
            "param/limit": 1.5,
            "param/label": "one",
            "param/fixed": 7,
            "param/cut": 0.5,
            "sensor/asked": 3.0,
        }
        self.reads: list[str] = []
        self.writes: list[tuple[str, Any]] = []
        self.ran: list[tuple[str, Any]] = []
        self.stopped: list[str] = []
        """Names of actions whose cancellation reached the robot."""
        self.watched: list[tuple[str, float | None]] = []
        self.left: list[str] = []
        self.halts = 0
        self.release = asyncio.Event()
        """Releases waiting actions."""

    async def read(self, name: str) -> Any:
        """Return a value, or fail as the name says."""
        self.reads.append(name)
        if name == "sensor/silent":
            await asyncio.Event().wait()
        if name in BROKEN:
            raise BROKEN[name]
        if name not in self.values:
            return await super().read(name)
        return self.values[name]

    async def write(self, name: str, value: Any) -> Any:
        """Accept a value, or refuse it as the name says."""
        if name == "param/refused":
            raise DeviceRejected("the valve is locked")
        if name == "param/slow":
            await self.release.wait()
        self.writes.append((name, value))
        self.values[name] = min(value, 1.0) if name == "param/cut" else value
        return self.values[name]

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Accept all values, unless one is to be refused."""
        if "param/refused" in values:
            raise DeviceRejected("the valve is locked", path="param/refused")
        return {name: await self.write(name, value) for name, value in values.items()}

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run the resource; an action behaves as its `mode` says."""
        self.ran.append((name, value))
        match name:
            case "service/echo":
                return value
            case "service/nothing":
                return None
            case "service/liar":
                return "a text where a number was promised"
            case _:
                return await self._go(name, value, progress)

    async def _go(self, name: str, value: Any, progress: Progress) -> Any:
        if value.mode == "refuse":
            raise DeviceRejected("the way is blocked")
        if value.mode == "crash":
            raise ZeroDivisionError("a secret of the backend's code")
        progress(value.distance / 2, fraction=0.5)
        match value.mode:
            case "stumble":
                raise DeviceRejected("lost the way after 1 m")
            case "timeout":
                raise DeviceTimeout("the wheels did not answer")
            case "wait":
                try:
                    await self.release.wait()
                except asyncio.CancelledError:
                    self.stopped.append(name)
                    raise
            case _:
                pass
        return value.distance

    @asynccontextmanager
    async def _watching(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        self.watched.append((name, rate))
        if name == "sensor/lazy":
            self.host.publish(name, 7.0)
        try:
            yield
        finally:
            self.left.append(name)

    def watch(self, name: str, rate: float | None) -> Any:
        """Note it; the lazy sensor publishes once it is watched."""
        return self._watching(name, rate)

    async def halt(self) -> None:
        """Note it."""
        self.halts += 1


@asynccontextmanager
async def _open(config: WireConfig, host: Host) -> AsyncGenerator[WireRobot]:
    host.declare(*(small() if config.small else resources()))
    yield WireRobot(host)


class Absence:
    """Whether the missing robot stays away."""

    ends = False


@asynccontextmanager
async def _absent(_config: WireConfig, host: Host) -> AsyncGenerator[WireRobot]:
    host.declare(*ghost())
    if not Absence.ends:
        raise NotReady("nobody answers at the other end")
    host.declare(*arrived())
    yield WireRobot(host)


ROBOT = BackendKind("wire-robot", WireConfig, _open)
DEAD = BackendKind("dead-robot", WireConfig, _absent)
"""A robot of which a part is declared, and that comes up only when a test requests it."""
