"""A goal without a height keeps the robot's own, which its bounds apply to."""

from __future__ import annotations

from typing import Any

import pytest
from jsonschema import Draft202012Validator

from configuration import backend, key, role, rule
from rcp_gateway.testing import ScriptedRobot, SteppedClock, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import Point, PoseStamped
from rcp_profiles.messages import MoveTo

pytestmark = pytest.mark.anyio
ADMIN, BLIND, FREE = (f"{name}-{name}-{name}-{name}" for name in ("admin", "blind", "free"))
MOVE_TO = "/action/move_to"
CONFIG = (
    backend(use="drone")
    + role("blind", rule("execute", MOVE_TO))
    + role("free", rule("execute", MOVE_TO))
    + """
[[envelopes]]
name = "ceiling"
roles = ["admin", "blind"]
paths = ["/action/move_to"]
[envelopes.bounds]
"position.z" = { min = 1, max = 3 }

[[envelopes]]
name = "any"
roles = ["free"]
paths = ["/action/move_to"]
[envelopes.bounds]
"position.z" = { max = 3, optional = true }
"""
    + key("admin", ADMIN, roles={"*": ["admin"]})
    + key("blind", BLIND, roles={"alpha": ["blind"]})
    + key("free", FREE, roles={"alpha": ["free"]})
)


def drone(host: Host) -> ScriptedRobot:
    robot = ScriptedRobot(
        host,
        Resource(name="sensor/pose", description="Where.", value=PoseStamped, live=True),
        Resource(name="action/move_to", description="Go there.", input=MoveTo, output=MoveTo),
    )
    robot.release.set()
    return robot


def at_height(served: Served, z: float, frame: str = "map") -> None:
    pose = PoseStamped(Point(0.0, 0.0, z), frame_id=frame)
    served.life.backend.host.publish("sensor/pose", pose)


async def go(served: Served, token: str = ADMIN, **position: float | None) -> dict[str, Any]:
    body = {"position": {"x": 1.0, "y": 2.0, **position}}
    return await served.client(token).request("execute", MOVE_TO, body=body)


async def test_a_height_that_is_kept_is_judged_as_one_that_is_named() -> None:
    async with serve(CONFIG, scripted(drone, "drone")) as served:
        at_height(served, 2.0)
        assert (await go(served))["status"] == "completed"
        assert served.life.backend.ran[-1][1].position.z is None  # it keeps it, by itself
        at_height(served, 5.0)
        refused = (await go(served, z=None))["error"]
        assert refused["code"] == "out_of_range"
        assert "the height that the robot keeps, 5 m, exceeds" in refused["message"]
        assert refused["details"]["value"] == 5.0
        assert refused["details"]["envelope"] == "ceiling"
        assert (await go(served, z=2.5))["status"] == "completed"
        assert (await go(served, z=3.5))["error"]["code"] == "out_of_range"
        assert (await go(served, FREE))["status"] == "completed"


async def test_who_may_not_know_where_the_robot_is_is_not_told_its_height() -> None:
    async with serve(CONFIG, scripted(drone, "drone")) as served:
        at_height(served, 5.0)
        refused = (await go(served, BLIND))["error"]
        assert refused["code"] == "out_of_range"
        assert "5" not in refused["message"]
        assert "value" not in refused["details"]


async def test_a_height_that_is_unknown_refuses_the_goal_with_the_reason(
    stepped: SteppedClock,
) -> None:
    async with serve(CONFIG, scripted(drone, "drone"), clock=stepped.clock) as served:

        async def unknown() -> None:
            refused = (await go(served))["error"]
            assert refused["code"] == "precondition_failed"
            assert "the height that the robot keeps is unknown" in refused["message"]

        await unknown()
        at_height(served, 2.0)
        assert (await go(served))["status"] == "completed"
        at_height(served, 2.0, "odom")
        await unknown()
        at_height(served, 2.0)
        stepped.advance(1.5)
        await unknown()


async def test_the_schema_that_discovery_shows_lets_the_height_out() -> None:
    async with serve(CONFIG, scripted(drone, "drone")) as served:
        reply = await served.client(ADMIN).request("discover", MOVE_TO)
        (found,) = reply["body"]["resources"]
        taken = Draft202012Validator(found["command_schema"]).is_valid
        assert taken({"position": {"x": 1.0, "y": 2.0}})
        assert taken({"position": {"x": 1.0, "y": 2.0, "z": None}})
        assert not taken({"position": {"x": 1.0, "y": 2.0, "z": 4.0}})
