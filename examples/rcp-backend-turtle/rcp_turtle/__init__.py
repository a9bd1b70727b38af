"""A turtle that walks over a sheet of paper and draws a line: a whole robot in one module."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress, check_fence
from rcp_kernel.types import Metres, Radians, quantity

TICK = 0.02  # s
Half = Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m"})]
Way = Annotated[float, Meta(ge=-50, le=50, extra_json_schema={"unit": "m"})]
Speed = Annotated[float, Meta(ge=-1, le=1, extra_json_schema={"unit": "m/s"})]
Turn = Annotated[float, Meta(ge=-3, le=3, extra_json_schema={"unit": "rad/s"})]
Pen = Literal["up", "down"]


class TurtleConfig(Struct, frozen=True, forbid_unknown_fields=True):
    half: Half = 5.0  # of the sheet's width and height


class Pose(Struct, frozen=True, forbid_unknown_fields=True):
    x: Metres = 0.0
    y: Metres = 0.0
    heading: Radians = 0.0


class Velocity(Struct, frozen=True, forbid_unknown_fields=True):
    forward: Speed = 0.0
    turn: Turn = 0.0


class Walk(Struct, frozen=True, forbid_unknown_fields=True):
    distance: Way


RESOURCES = (
    Resource(name="sensor/pose", description="Where it is.", value=Pose, live=True, deadline=1.0),
    Resource(name="sensor/ink", description="Length drawn so far.", value=Metres, live=True),
    Resource(name="param/pen", description="Whether it draws.", value=Pen, examples=("up",)),
    Resource(
        name="actuator/velocity",
        description="How fast it walks and turns.",
        value=Velocity,
        examples=({"forward": 0.5}, {"turn": 1.0}),
        safe=Velocity(),
        valid_for=0.5,
    ),
    Resource(
        name="action/walk",
        description="Walk straight ahead, or back.",
        input=Walk,
        output=Pose,
        feedback=quantity("m", description="Still to go."),
        examples=({"distance": 0.5},),
        timeout=120.0,
    ),
    Resource(name="service/new_sheet", description="Take a new sheet; go to its middle."),
)


class Turtle(BaseBackend):
    def __init__(self, config: TurtleConfig, host: Host) -> None:
        self.host, self.half = host, config.half
        self.pose, self.velocity, self.pen, self.ink = Pose(), Velocity(), "down", 0.0

    def ahead(self, distance: float) -> Pose:
        x = self.pose.x + distance * math.cos(self.pose.heading)
        y = self.pose.y + distance * math.sin(self.pose.heading)
        return Pose(x, y, self.pose.heading)

    def inside(self, pose: Pose) -> bool:
        return abs(pose.x) <= self.half and abs(pose.y) <= self.half

    async def live(self) -> None:
        while True:
            distance = self.velocity.forward * TICK
            if self.inside(self.ahead(distance)):
                self.pose = self.ahead(distance)
                self.ink += abs(distance) if self.pen == "down" else 0.0
            heading = math.remainder(self.pose.heading + self.velocity.turn * TICK, math.tau)
            self.pose = Pose(self.pose.x, self.pose.y, heading)
            self.host.publish("sensor/pose", self.pose)
            self.host.publish("sensor/ink", self.ink)
            await asyncio.sleep(TICK)

    async def read(self, name: str) -> Any:
        return getattr(self, name.partition("/")[2])

    async def write(self, name: str, value: Any) -> None:
        check_fence()
        setattr(self, name.partition("/")[2], value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Pose | None:
        if name == "service/new_sheet":
            self.pose, self.ink = Pose(), 0.0
            return None
        if not self.inside(self.ahead(value.distance)):
            raise DeviceRejected("the sheet ends before that")
        check_fence()
        start, whole = self.pose, abs(value.distance) or 1.0
        self.velocity = Velocity(math.copysign(0.5, value.distance))
        try:
            while (left := whole - math.dist((start.x, start.y), (self.pose.x, self.pose.y))) > 0:
                progress(left, fraction=1 - left / whole)
                await asyncio.sleep(TICK)
        finally:
            await self.halt()
        return self.pose

    async def halt(self) -> None:
        self.velocity = Velocity()

    def motion(self, robot: str | None) -> MotionState:
        return MotionState(at_rest=self.velocity == Velocity())


@asynccontextmanager
async def open_turtle(config: TurtleConfig, host: Host) -> AsyncGenerator[Turtle]:
    turtle = Turtle(config, host)
    host.declare(*RESOURCES)
    async with asyncio.TaskGroup() as tasks:
        life = tasks.create_task(turtle.live())
        yield turtle
        life.cancel()


TURTLE = BackendKind("turtle", TurtleConfig, open_turtle, "A turtle that draws.")


@hookimpl
def rcp_backends() -> list[BackendKind]:
    return [TURTLE]
