"""A differential drive on the bench: two CiA 402 drives on one bus, and the robot that they make."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import anyio
import can

from backends.can.rig import PATIENT, Rig, channel, opened
from rcp_can.odometry import Place
from rcp_can.sim import Bench, Twin, make_twin

__all__ = ["LEFT", "RIGHT", "Rover", "Truth", "rover", "rover_bench", "tables", "twins"]

LEFT, RIGHT = 1, 2  # nodes
TRACK, RADIUS = 0.4, 0.1  # m


def tables(name: str) -> dict[str, Any]:
    """Return the configuration of the rover on a channel; its right motor is mounted in reverse."""
    wheel: dict[str, Any] = {"bus": "can0", "profile": "cia402", "rate": 100, "velocity": 10.0}
    wheel |= {"acceleration": 20.0, "timeout": 1.0, "feedback_timeout": 1.0}
    options = {"control": "cyclic", "feedback": 10, **PATIENT["options"]}
    wheel |= {**PATIENT, "options": options}
    motors = {
        "left": {**wheel, "node": LEFT},
        "right": {**wheel, "node": RIGHT, "direction": -1},
    }
    base = {"left": "left", "right": "right", "track": TRACK, "radius": RADIUS, "as_robot": True}
    bus = {"interface": "virtual", "channel": name, "restart": 0.3, "statistics": 0.1}
    return {
        "buses": {"can0": bus},
        "motors": motors,
        "diff_drives": {"base": base},
        "grace": 5.0,
    }


class Truth(Twin):
    """Where the rover is by its wheels' shafts; on the bench beside them, and not on the bus."""

    def __init__(self, left: Twin, right: Twin) -> None:
        super().__init__(0)
        self.left, self.right = left.plant, right.plant
        self.x = self.y = 0.0
        self._before = (0.0, 0.0)

    def take(self, message: can.Message) -> None:
        """Hear nothing."""

    def tick(self, now: float) -> None:
        """Go on by what the shafts have turned."""
        (way, heading), before = (self.way, self.heading), self._before
        middle = (heading + before[1]) / 2
        self.x += (way - before[0]) * math.cos(middle)
        self.y += (way - before[0]) * math.sin(middle)
        self._before = way, heading

    @property
    def heading(self) -> float:
        return RADIUS * (-self.right.position - self.left.position) / TRACK

    @property
    def way(self) -> float:
        return RADIUS * (self.left.position - self.right.position) / 2

    @property
    def moving(self) -> tuple[float, float]:
        left, right = self.left.velocity, -self.right.velocity
        return RADIUS * (left + right) / 2, RADIUS * (right - left) / TRACK

    def still(self) -> bool:
        return abs(self.left.velocity) < 0.1 and abs(self.right.velocity) < 0.1


def rover_bench(line: can.BusABC) -> Bench:
    """Put both wheels, and the truth about them, on a bench."""
    left, right = (make_twin("cia402", node, control="cyclic") for node in (LEFT, RIGHT))
    return Bench(line, [left, right, Truth(left, right)])


def twins(bench: Bench) -> tuple[Any, Any, Truth]:
    """Return the wheels of a bench, and the truth."""
    left, right, truth = bench.twins
    assert isinstance(truth, Truth)
    return left, right, truth


class Rover(Rig):
    """The backend, the twins of its wheels, and what they really do."""

    def __init__(self, rig: Rig, bench: Bench, name: str) -> None:
        super().__init__(rig.backend, rig.host)
        self.bench, self.channel = bench, name
        self.left, self.right, self.truth = twins(bench)

    @property
    def place(self) -> Place:
        pose = self.host.last("sensor/pose")
        turned = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
        return Place(pose.position.x, pose.position.y, math.remainder(turned, 2 * math.pi))

    async def until(self, holds: Callable[[], object], seconds: float = 60.0) -> None:
        with anyio.fail_after(seconds):
            while not holds():  # noqa: ASYNC110  # a twin lives in a thread that tells nobody
                await asyncio.sleep(0.002)

    async def ordered(self, function: Callable[[], object]) -> None:
        """Do something in the twins' thread."""
        done, loop = asyncio.Event(), asyncio.get_running_loop()

        def do() -> None:
            function()
            loop.call_soon_threadsafe(done.set)

        self.bench.order(do)
        with anyio.fail_after(60):
            await done.wait()

    async def velocity(self, forward: float, turn: float = 0.0) -> Any:
        return await self.write(
            "actuator/cmd_vel", {"linear": {"x": forward}, "angular": {"z": turn}}
        )

    def moving(self, x: float, y: float = 0.0, **more: Any) -> asyncio.Future[Any]:
        goal = {"position": {"x": x, "y": y}, "frame": "odom", **more}
        return asyncio.ensure_future(self.execute("action/move_to", goal))

    def stops(self) -> list[Any]:
        return self.host.events("event/stopped")


@asynccontextmanager
async def rover(*, enabled: bool = True) -> AsyncGenerator[Rover]:
    """Run two drives, and a backend that makes a rover of them."""
    name = channel()
    line = can.Bus(name, "virtual", ignore_config=True)
    with rover_bench(line) as bench:
        async with opened(tables(name)) as rig:
            found = Rover(rig, bench, name)
            if enabled:
                await found.ran("service/enable")
            yield found
