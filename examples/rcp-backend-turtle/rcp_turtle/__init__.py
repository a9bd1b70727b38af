"""A turtle that walks over a sheet of paper and draws a line: a whole robot in one module."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.errors import DeviceRejected, InvalidValue
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress, check_fence
from rcp_kernel.types import (
    AngularVelocity,
    LinearVelocity,
    Metres,
    Point,
    PoseStamped,
    Quaternion,
    Twist,
)
from rcp_profiles import claim, offer, twist_limits
from rcp_profiles.messages import MoveFeedback, MoveResult, MoveTo, TwistStamped

TICK = 0.02  # s
TOP, TURN = 1.0, 3.0  # m/s, rad/s
NEAR, FACING = 0.02, 0.03  # m, rad
Half = Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m"})]
Pen = Literal["up", "down"]


class TurtleConfig(Struct, frozen=True, forbid_unknown_fields=True):
    half: Half = 5.0  # of the sheet's width and height


RESOURCES = claim(
    ["mobile"],
    offer("sensor/pose", live=True, deadline=1.0),
    offer("sensor/velocity", live=True, deadline=1.0),
    offer("actuator/cmd_vel", twist_limits(x=TOP, yaw=TURN)),
    offer("action/move_to", {"speed": (None, TOP)}, timeout=120.0),
    offer("param/speed_limit", (0, TOP)),
    Resource(name="sensor/ink", description="Length drawn so far.", value=Metres, live=True),
    Resource(name="param/pen", description="Whether it draws.", value=Pen, examples=("up",)),
    Resource(name="service/new_sheet", description="Take a new sheet; go to its middle."),
)


def clipped(value: float, most: float) -> float:
    return max(-most, min(most, value))


class Turtle(BaseBackend):
    def __init__(self, config: TurtleConfig, host: Host) -> None:
        self.host, self.half = host, config.half
        self.x = self.y = self.yaw = 0.0
        self.v = self.w = 0.0
        self.limit, self.pen, self.ink = 0.5, "down", 0.0

    def pose(self) -> PoseStamped:
        turned = Quaternion(z=math.sin(self.yaw / 2), w=math.cos(self.yaw / 2))
        return PoseStamped(Point(self.x, self.y), turned)

    def velocity(self) -> TwistStamped:
        return TwistStamped(LinearVelocity(self.v), AngularVelocity(z=self.w))

    def inside(self, x: float, y: float) -> bool:
        return abs(x) <= self.half and abs(y) <= self.half

    async def live(self) -> None:
        while True:
            x = self.x + self.v * math.cos(self.yaw) * TICK
            y = self.y + self.v * math.sin(self.yaw) * TICK
            if self.inside(x, y):
                self.x, self.y = x, y
                self.ink += abs(self.v) * TICK if self.pen == "down" else 0.0
            self.yaw = math.remainder(self.yaw + self.w * TICK, math.tau)
            for name in ("sensor/pose", "sensor/velocity", "sensor/ink"):
                self.host.publish(name, self.value(name))
            await asyncio.sleep(TICK)

    def value(self, name: str) -> Any:
        match name:
            case "sensor/pose":
                return self.pose()
            case "sensor/velocity":
                return self.velocity()
            case "actuator/cmd_vel":
                return Twist(LinearVelocity(self.v), AngularVelocity(z=self.w))
            case "param/speed_limit":
                return self.limit
            case _:
                return getattr(self, name.partition("/")[2])

    async def read(self, name: str) -> Any:
        return self.value(name)

    async def write(self, name: str, value: Any) -> Any:
        match name:
            case "actuator/cmd_vel":
                self.go(value.linear.x, value.angular.z)
            case "param/speed_limit":
                self.limit = value
                self.v = clipped(self.v, value)
            case _:
                self.pen = value
        return self.value(name)

    def go(self, v: float, w: float) -> None:
        check_fence()
        self.v, self.w = clipped(v, self.limit), w

    async def execute(self, name: str, value: Any, progress: Progress) -> MoveResult | None:
        if name == "service/new_sheet":
            self.x = self.y = self.yaw = self.ink = 0.0
            return None
        if value.frame != "map":
            raise InvalidValue(f"the turtle knows no frame '{value.frame}', only 'map'")
        if not self.inside(value.position.x, value.position.y):
            raise DeviceRejected("the sheet ends before that")
        try:
            await self.walk(value, progress)
        finally:
            await self.halt()
        return MoveResult(self.pose(), self.left(value))

    def left(self, goal: MoveTo) -> float:
        return math.dist((goal.position.x, goal.position.y), (self.x, self.y))

    async def walk(self, goal: MoveTo, progress: Progress) -> None:
        pace, near = goal.speed or TOP, goal.tolerance or NEAR
        whole = self.left(goal) or 1.0
        while (left := self.left(goal)) > near:
            eta = left / min(pace, self.limit) if self.limit else None
            progress(MoveFeedback(left, eta), fraction=max(0.0, 1 - left / whole))
            off = self.off(math.atan2(goal.position.y - self.y, goal.position.x - self.x))
            self.go(min(pace, 5 * left) if abs(off) < FACING else 0.0, clipped(5 * off, TURN))
            await asyncio.sleep(TICK)
        while goal.yaw is not None and abs(off := self.off(goal.yaw)) > FACING:
            self.go(0.0, clipped(5 * off, TURN))
            await asyncio.sleep(TICK)

    def off(self, yaw: float) -> float:
        return math.remainder(yaw - self.yaw, math.tau)

    async def halt(self) -> None:
        self.v = self.w = 0.0

    def motion(self, robot: str | None) -> MotionState:
        return MotionState(at_rest=self.v == self.w == 0.0)


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
