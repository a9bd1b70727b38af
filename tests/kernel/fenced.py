"""A robot with everything that an envelope may be about, and a gateway around it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal

import msgspec

from configuration import key, role, rule
from kernel.world import CONFIG as PLAIN
from kernel.world import Client, Robot, World, prepared, world_of
from rcp_gateway.reload import apply
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.clock import Clock as GatewayClock
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_kernel.types import Int64, Pose, Real, Twist, quantity

CONFIG = (
    PLAIN
    + key("agent", "agent-agent-agent")
    + key("both", "both-both-both-both", role=["operator", "agent"])
    + role("blind", rule("write execute", "/actuator/**", "/action/**"))
    + key("blind", "blind-blind-blind")
)
AGENT, OPERATOR, BOTH, BLIND = (
    "agent-agent-agent",
    "operator-operator",
    "both-both-both-both",
    "blind-blind-blind",
)


class Joint(msgspec.Struct, frozen=True):
    """One joint."""

    velocity: Annotated[float, msgspec.Meta(extra_json_schema={"unit": "rad/s"})] = 0.0
    name: str = ""


class Arm(msgspec.Struct, frozen=True, rename="camel"):
    """An arm, whose fields have other names on the wire."""

    all_joints: list[Joint]
    top_speed: float | None = None


class Goal(msgspec.Struct, frozen=True):
    """Where to go."""

    pose: Pose
    speed: quantity("m/s") | None = None  # pyright: ignore[reportInvalidTypeForm]


class FencedRobot(Robot):
    """Writes down whatever reaches it."""

    def declare(self) -> None:
        super().declare()
        self.add(
            Resource(
                name="sensor/pose", description="A pose.", value=Pose, live=True, deadline=10.0
            ),
            Resource(
                name="sensor/level",
                description="A level.",
                value=quantity("m"),
                live=True,
                deadline=30.0,
            ),
            Resource(name="sensor/mode", description="A mode.", value=str),
            Resource(
                name="actuator/drive",
                description="A drive.",
                value=Twist,
                valid_for=5.0,
                safe=Twist(),
            ),
            Resource(name="actuator/arm", description="An arm.", value=Arm),
            Resource(name="actuator/speeds", description="Speeds.", value=list[float]),
            Resource(name="actuator/raw", description="A raw number.", value=Real),
            Resource(name="actuator/any", description="Anything.", value=dict[str, Any]),
            Resource(
                name="actuator/grip",
                description="A grip.",
                value=Literal["open", "shut", "squeeze"],
            ),
            Resource(name="param/count", description="A count.", value=Int64),
            Resource(name="action/move", description="Moves.", input=Goal),
            Resource(name="action/line_up", description="Moves.", input=Goal, policy="queue"),
            Resource(name="action/many", description="Moves.", input=Goal, policy="parallel"),
        )

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if name not in ("action/move", "action/line_up", "action/many"):
            return await super().execute(name, value, progress)
        self.writes.append((name, value))
        self.started.put_nowait(value)
        await self.release.wait()
        return None

    def at(self, x: float, y: float = 0.0) -> None:
        """Publish a place."""
        self.host.publish("sensor/pose", {"position": {"x": x, "y": y}})


@asynccontextmanager
async def fenced(envelopes: str, clock: GatewayClock = SYSTEM_CLOCK) -> AsyncGenerator[World]:
    """Run a gateway with envelopes around the robot."""
    async with world_of(CONFIG + envelopes, FencedRobot, clock) as world:
        yield world


async def reconfigured(world: World, envelopes: str) -> None:
    """Have a running gateway take over other envelopes."""
    config = parse(CONFIG + envelopes, "test")
    await apply(world.server, prepared(config, []))


def twist(x: float, z: float = 0.0) -> dict[str, Any]:
    """Write a velocity as plain data."""
    return {"linear": {"x": x}, "angular": {"z": z}}


async def drive(client: Client, x: Any, z: Any = 0.0, **fields: Any) -> dict[str, Any]:
    """Command a velocity."""
    return await client.ask(type="write", path="/actuator/drive", body=twist(x, z), **fields)


def code(reply: dict[str, Any]) -> str:
    """Return how a request ended."""
    return reply["error"]["code"] if "error" in reply else reply["status"]


SLOW = """
[[envelopes]]
name = "slow"
paths = ["/actuator/drive"]
roles = ["agent"]
bounds = { "linear.x" = { min = -0.5, max = 0.5 }, "angular.z" = { max = 1 } }
reason = "people walk here"
"""
EDGE = """
[[envelopes]]
name = "hall"
paths = ["/actuator/**", "/action/move"]
roles = ["agent"]
fence = { of = "sensor/pose", inside = { hall = [[0, -5], [10, -5], [10, 5], [0, 5]] } }
"""
GOALS = """
[[envelopes]]
name = "goals"
paths = ["/tenant/alpha/action/move", "/action/line_up"]
fence = { point = ["pose.position.x", "pose.position.y"], inside = { hall = [[0,0],[9,0],[9,9],[0,9]] }, outside = { pit = [[4,4],[5,4],[5,5]] } }
"""


GENTLE = SLOW.replace("bounds =", 'rate = { "linear.x" = 1.0 }\nbounds =').replace(
    "min = -0.5, max = 0.5", "min = -5, max = 5"
)


class Clock:
    """Time that a test moves."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.clock = GatewayClock(monotonic=lambda: self.now)
        """As a gateway takes it."""


def goal(x: Any, y: Any = 1.0, **more: Any) -> dict[str, Any]:
    return {"pose": {"position": {"x": x, "y": y}}, **more}


def reached(world: World, name: str = "actuator/drive") -> list[Any]:
    writes: list[tuple[str, Any]] = world.robot.writes
    return [value for path, value in writes if path == name]
