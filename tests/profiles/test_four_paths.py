"""The four paths of the paper answer on every mobile robot of the demo and on a ROS 2 robot without a map.

The same names and the same arguments for each of them, by a client over the network.
"""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import rcp_client
from docs.demo import demo
from docs.pages import ROOT
from patrol.machines import KEY, MACHINES
from rcp_gateway.testing import eventually
from rcp_kernel.config.file import parse
from rcp_kernel.errors import RcpError
from rcpd.demo import Demo

pytestmark = pytest.mark.anyio

PATHS = ("sensor/pose", "param/speed_limit", "action/move_to", "service/reset_system")
OF_THE_DEMO = {"/tenant/alpha", "/tenant/beta", "/tenant/gamma", "/tenant/epsilon"}
AWAY = 1.0  # m
NEAR = 0.8  # m from the goal, for a copter
LIMIT = 0.5  # m/s
BEYOND = "Failed to apply configuration: parameter 'speed_limit' exceeds allowed range: "
_WITHIN = 240.0  # s for a flight on any machine
_READY = 60.0  # s


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the kernel's event loop."""
    return "asyncio"


class Robot:
    """One robot, by the names of the profiles."""

    def __init__(self, client: rcp_client.Client, facts: dict[str, Any]) -> None:
        self.client, self.path = client, facts["path"]
        self.flies = any(name.startswith("aerial/") for name in facts["profiles"])

    async def execute(self, name: str, value: Any = None, **more: Any) -> Any:
        """Execute it to its end."""
        return await self.client.execute(f"{self.path}/{name}", value, **more)

    async def answers(self) -> None:
        """Use each of the four paths."""
        for name in PATHS:
            found = await self.client.discover(f"{self.path}/{name}")
            assert [one.path for one in found] == [f"{self.path}/{name}"], (self.path, name)
        await self._limits()
        await self._placed()
        if await self.client.discover(f"{self.path}/service/enable"):
            await self.execute("service/enable")
        if self.flies:
            await self.execute("action/takeoff", {"altitude": 3.0})
        await self._moves()
        if self.flies:
            await self.execute("action/land")
        await self._resets()

    async def _pose(self) -> tuple[float, float, str]:
        pose = await self.client.read(f"{self.path}/sensor/pose", fresh=True)
        at, turn = pose["position"], pose["orientation"]
        assert math.isclose(math.hypot(*(turn[axis] for axis in "xyzw")), 1.0, abs_tol=1e-3), pose
        return at["x"], at["y"], pose["frame_id"]

    async def _limits(self) -> None:
        path = f"{self.path}/param/speed_limit"
        before = await self.client.read(path, fresh=True)
        assert before > 0.0, (path, before)
        with pytest.raises(RcpError) as refused:
            await self.client.write(path, -1.0)
        assert refused.value.code == "out_of_range", (path, refused.value)
        assert refused.value.message.startswith(BEYOND), (path, refused.value)
        await self.client.write(path, LIMIT)
        assert math.isclose(await self.client.read(path, fresh=True), LIMIT, rel_tol=0.01), path

    async def _moves(self) -> None:
        x, y, frame = await self._pose()
        left: list[float] = []
        goal = {"position": {"x": x + AWAY, "y": y}, "frame": frame}

        def note(feedback: rcp_client.Feedback) -> None:
            if feedback.body is not None:
                left.append(feedback.body["distance_remaining"])

        done = await self.execute("action/move_to", goal, on_feedback=note)
        assert left, f"{self.path} tells nothing on the way"
        assert max(left) <= AWAY + NEAR, (self.path, left)
        assert done["error"] <= NEAR, (self.path, done)
        there = await self._pose()
        assert math.dist(there[:2], (x + AWAY, y)) <= NEAR, (self.path, x, y, there)

    async def _resets(self) -> None:
        await self.execute("service/reset_system")
        velocity = await self.client.read(f"{self.path}/sensor/velocity", fresh=True)
        assert abs(velocity["linear"]["x"]) < 0.1, (self.path, velocity)
        await self._placed()
        assert await self.client.read(f"{self.path}/param/speed_limit", fresh=True) > 0.0

    async def _placed(self) -> None:
        """Wait for its pose: after power-on an autopilot has none at first, and cannot be armed."""

        async def placed() -> bool:
            with suppress(RcpError):
                await self._pose()
                return True
            return False

        await eventually(placed, f"{self.path} tells its pose", _READY)


async def mobile(client: rcp_client.Client) -> list[dict[str, Any]]:
    """List the robots that claim `mobile`."""
    robots = await client.robots()
    return [one for one in robots if any(n.startswith("mobile/") for n in one.get("profiles", ()))]


async def test_they_answer_on_every_mobile_robot_of_the_demo(tmp_path: Path) -> None:
    with demo(tmp_path) as live:
        async with rcp_client.connect(live.url, token=live.key) as client:

            async def ready() -> bool:
                found = {one["path"]: one["state"] for one in await mobile(client)}
                return found == dict.fromkeys(OF_THE_DEMO, "ready")

            await eventually(ready, "the robots of the demo are ready", _READY)
            async with asyncio.timeout(_WITHIN), asyncio.TaskGroup() as group:
                for facts in await mobile(client):
                    group.create_task(Robot(client, facts).answers())


async def test_they_answer_on_a_ros_2_robot_without_a_map() -> None:
    async with MACHINES["ROS 2 rover"]() as machine:
        async with rcp_client.connect(machine.url, token=KEY) as client:
            (facts,) = await mobile(client)
            start = machine.truth()
            async with asyncio.timeout(_WITHIN):
                await Robot(client, facts).answers()
        end = machine.truth()
        assert math.dist((end.x, end.y), (start.x + AWAY, start.y)) < machine.near
        assert end.still


def test_the_demo_has_the_robots_of_its_example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPERATOR_KEY", "operator-of-the-example")
    text = (ROOT / "examples" / "demo.toml").read_text(encoding="utf-8")
    example, runs = parse(text, "demo.toml"), parse(Demo(0).config("info"), "rcpd demo")
    named = lambda config: {(one.name, one.use, one.tenant) for one in config.backends}  # noqa: E731
    assert named(example) == named(runs)
