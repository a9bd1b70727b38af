"""The turtle keeps what the house asks of a backend."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rcp_kernel.config.file import parse
from rcp_kernel.testing import BackendSuite, Goal, StopRig, StopSuite, serve

import rcp_turtle


class TurtleRig(StopRig):
    kind = rcp_turtle.TURTLE

    async def truth(self, name: str) -> Any:
        word = {"action/walk": "pose"}.get(name, name.partition("/")[2])
        return getattr(self.backend, word)

    async def at_rest(self) -> bool:
        return self.backend.velocity == rcp_turtle.Velocity()

    def goals(self) -> Mapping[str, Goal]:
        walk = Goal(good={"distance": 0.02}, bad={"distance": 20.0}, long={"distance": 3.0})
        return {"action/walk": walk}


class TestTurtle(TurtleRig, BackendSuite):
    """What any backend owes."""


class TestTurtleStops(TurtleRig, StopSuite):
    """What any stop owes."""


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_it_draws_as_the_example_configures_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TURTLE_KEY", "a-key-for-this-test")
    text = (Path(__file__).parents[2] / "turtle.toml").read_text(encoding="utf-8")
    config = msgspec.structs.replace(parse(text, "turtle.toml"), transports={})
    async with serve(config, rcp_turtle.TURTLE) as served:
        client = served.client("a-key-for-this-test")
        walked = await client.request("execute", "/action/walk", body={"distance": 0.1})
        assert walked["status"] == "completed"
        assert walked["path"] == "/tenant/studio/action/walk"
        assert (await client.request("read", "/sensor/ink"))["body"] >= 0.1
        too_far = await client.request("execute", "/action/walk", body={"distance": 3.5})
        assert "the sheet ends" in too_far["message"]


def test_it_is_offered_under_its_name() -> None:
    points = entry_points(group="rcp.backends", name="turtle")
    assert [point.value for point in points] in ([], ["rcp_turtle"])  # none: not installed here
