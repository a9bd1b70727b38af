"""DroneCAN nodes of the library on a bench, with a gateway's backend in front of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any, Self

import anyio
import can

from backends.can.rig import Node, Rig, channel, opened
from rcp_can.dronecan.transfers import Assembler, Received
from rcp_can.sim import Bench
from rcp_can.sim.dronecan import DronecanTwin

FAST = 40.0  # rad/s
RPM, RAW, STATUS, ARMING = 1031, 1030, 341, 1100


class Field(Rig):
    """A backend with motors and nodes, and the twins behind it."""

    def __init__(self, rig: Rig, bench: Bench, channel: str) -> None:
        super().__init__(rig.backend, rig.host)
        self.bench, self.twins, self.channel = bench, bench.twins, channel

    async def until(self, holds: Callable[[], object], seconds: float = 60.0) -> None:
        with anyio.fail_after(seconds):
            while not holds():  # noqa: ASYNC110  # twins live in a thread that tells nobody
                await asyncio.sleep(0.002)


@asynccontextmanager
async def field(*twins: DronecanTwin, **tables: Any) -> AsyncGenerator[Field]:
    name = channel()
    bus = {"interface": "virtual", "channel": name, "statistics": 0.05}
    line = can.Bus(name, "virtual", ignore_config=True)
    with Bench(line, twins) as bench:
        async with opened({"buses": {"can0": bus}, **tables}) as rig:
            yield Field(rig, bench, name)


def esc(node: int, index: int, **more: Any) -> dict[str, Any]:
    """Return the table of a motor."""
    slow = {"timeout": 1.0, "feedback_timeout": 1.0, "velocity": 100.0}  # on machines that do much
    options = {"index": index, **more.pop("options", {})}
    return {"bus": "can0", "profile": "dronecan", "node": node, "options": options, **slow, **more}


def turns(twin: Any, speed: float) -> Callable[[], bool]:
    return lambda: abs(twin.plant.velocity - speed) < 0.5


class Ear:
    """Decodes what is on a bus, by the number of its type."""

    def __init__(self, name: str) -> None:
        self._node = Node(name)
        self._assembler = Assembler((RPM, RAW, STATUS, ARMING, 1))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.bus.shutdown()

    def send(self, frames: list[tuple[int, bytes]]) -> None:
        for identifier, data in frames:
            self._node.send(identifier, data, is_extended_id=True)

    async def hears(self, wanted: Callable[[Received], object]) -> Received:
        found: list[Received] = []

        def take(message: can.Message) -> bool:
            whole = self._assembler.take(message)
            if whole is not None and wanted(whole):
                found.append(whole)
            return bool(found)

        await self._node.hears(take)
        return found[0]


def from_gateway(type_id: int) -> Callable[[Received], bool]:
    return lambda got: got.type_id == type_id and got.source == 126
