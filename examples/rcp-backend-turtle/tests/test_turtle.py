"""The turtle keeps what the house asks of a backend."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rcp_gateway.testing import BackendSuite, Body, Goal, ProfileSuite, StopRig, StopSuite, serve
from rcp_kernel.config.file import parse

import rcp_turtle


class TurtleRig(StopRig):
    kind = rcp_turtle.TURTLE

    async def truth(self, name: str) -> Any:
        turtle = self.backend
        return {
            "actuator/cmd_vel": {"linear": {"x": turtle.v}, "angular": {"z": turtle.w}},
            "param/speed_limit": turtle.limit,
            "param/pen": turtle.pen,
        }[name]

    async def confirms(self, name: str, result: Any) -> bool:
        at = result["pose"]["position"]
        return math.dist((at["x"], at["y"]), (self.backend.x, self.backend.y)) < 0.01

    async def at_rest(self) -> bool:
        return self.backend.v == self.backend.w == 0.0

    def goals(self) -> Mapping[str, Goal]:
        good, bad, far = ({"position": {"x": x, "y": 0.0}} for x in (0.05, 20.0, 3.0))
        return {"action/move_to": Goal(good=good, bad=bad, long=far)}


class TestTurtle(TurtleRig, BackendSuite):
    """What any backend owes."""


class TestTurtleStops(TurtleRig, StopSuite):
    """What any stop owes."""


class TestTurtleProfiles(ProfileSuite):
    """What its profile means."""

    kind = rcp_turtle.TURTLE
    profiles = ("mobile",)

    async def body(self) -> Body:
        turtle = self.backend
        return Body(x=turtle.x, y=turtle.y, yaw=turtle.yaw, forward=turtle.v, yaw_rate=turtle.w)


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_it_draws_as_the_example_configures_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TURTLE_KEY", "a-key-for-this-test")
    text = (Path(__file__).parents[2] / "turtle.toml").read_text(encoding="utf-8")
    config = msgspec.structs.replace(parse(text, "turtle.toml"), transports={})
    async with serve(config, rcp_turtle.TURTLE) as served:
        client = served.client("a-key-for-this-test")
        goal = {"position": {"x": 0.1, "y": 0.0}}
        walked = await client.request("execute", "/action/move_to", body=goal)
        assert walked["status"] == "completed"
        assert walked["path"] == "/tenant/studio/action/move_to"
        assert (await client.request("read", "/sensor/ink"))["body"] >= 0.05
        goal = {"position": {"x": 3.5, "y": 0.0}}
        too_far = await client.request("execute", "/action/move_to", body=goal)
        assert "the sheet ends" in too_far["message"]


def test_it_is_offered_under_its_name() -> None:
    points = entry_points(group="rcp.backends", name="turtle")
    assert [point.value for point in points] in ([], ["rcp_turtle"])  # none: not installed here
