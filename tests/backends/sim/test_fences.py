"""The rover of the fenced example drives against its fence, and is stopped there."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from rcp_gateway.testing import Client, Served, serve
from rcp_kernel.config.file import GatewayConfig, load

pytestmark = pytest.mark.anyio
EXAMPLE = Path(__file__).parents[3] / "examples" / "fenced.toml"
AGENT, OPERATOR = "agent-key-of-the-test", "operator-key-of-the-test"
BOUND = 60.0  # s any wait may take


def config(monkeypatch: pytest.MonkeyPatch, x: float, **options: Any) -> GatewayConfig:
    """Return the example with the rover at a place of its aisle, and without sockets."""
    monkeypatch.setenv("AGENT_KEY", AGENT)
    monkeypatch.setenv("OPERATOR_KEY", OPERATOR)
    read = load(EXAMPLE)
    table = {"noise": 0, "map_resolution": 0.5, "start": {"x": x}, **options}
    backends = tuple(msgspec.structs.replace(b, options=table) for b in read.backends)
    return msgspec.structs.replace(read, backends=backends, transports={})


@asynccontextmanager
async def rover(
    monkeypatch: pytest.MonkeyPatch, x: float, **options: Any
) -> AsyncGenerator[Served]:
    async with serve(config(monkeypatch, x, **options)) as served, asyncio.timeout(BOUND):
        yield served


async def drive(client: Client, x: float) -> str:
    reply = await client.request("write", "/actuator/cmd_vel", body={"linear": {"x": x}})
    return reply.get("error", {}).get("code", reply["status"])


class Seat:
    """Who drives, seeing the rover's place twenty times a second."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.stream = ""
        self.place = math.nan

    @classmethod
    async def of(cls, served: Served, token: str) -> Seat:
        seat = cls(served.client(token))
        seat.stream = await seat.client.subscribe("/sensor/pose", rate=20)
        return seat

    async def look(self) -> tuple[float, float]:
        """Wait for the next look at the rover; return its place along x and its way since."""
        self.client.inbox[:] = [m for m in self.client.inbox if m["type"] != "update"]
        x = (await self.client.update(self.stream))["body"]["position"]["x"]
        was, self.place = self.place, x
        return x, x - was

    async def drive(self, x: float, *, until: Callable[[float, float], bool]) -> set[str]:
        """Command a velocity with each look until one will do; return how that was answered."""
        said: set[str] = set()
        while not until(*(await self.look())):
            said.add(await drive(self.client, x))
        return said


async def test_a_program_drives_up_to_the_fence_and_no_further(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with rover(monkeypatch, 2.6) as served:
        agent, anna = await Seat.of(served, AGENT), await Seat.of(served, OPERATOR)
        said = await agent.drive(0.5, until=lambda x, _: x > 3.0)
        assert "completed" in said
        said = await agent.drive(0.5, until=lambda _, moved: moved == 0)
        assert said <= {"out_of_range"}
        assert (await agent.client.notice("fence_left"))["envelope"] == "aisle"
        assert 3.0 < (await agent.look())[0] < 3.25
        assert await drive(agent.client, -0.1) == "out_of_range"

        assert await anna.drive(-0.5, until=lambda x, _: x < 2.9) == {"completed"}
        await drive(anna.client, 0.0)
        said = await agent.drive(-0.1, until=lambda x, _: x < 2.8)
        assert "completed" in said


async def test_a_person_drives_through_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async with rover(monkeypatch, 2.8) as served:
        anna = await Seat.of(served, OPERATOR)
        assert await anna.drive(1.0, until=lambda x, _: x > 3.4) == {"completed"}


async def sent(served: Served, x: float, y: float, **more: float) -> str:
    """Try to send the rover somewhere; return what would become of it."""
    body = {"position": {"x": x, "y": y}, **more}
    agent = served.client(AGENT)
    reply = await agent.request("execute", "/action/move_to", body=body, dry_run=True)
    return reply.get("error", {}).get("code", reply["status"])


async def test_an_action_is_held_to_its_goal_and_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    async with rover(monkeypatch, 0.0) as served:
        assert await sent(served, 2.0, 1.0) == "completed"
        assert await sent(served, 3.5, 0.0) == "out_of_range"
        assert await sent(served, -3.5, 1.5) == "out_of_range"
        assert await sent(served, 2.0, 1.0, speed=1.0) == "out_of_range"


async def test_an_empty_battery_keeps_programs_from_driving(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with rover(monkeypatch, 0.0, battery={"charge": 0.1}) as served:
        assert await sent(served, 2.0, 1.0) == "precondition_failed"
        assert await drive(served.client(OPERATOR), 0.3) == "completed"


async def test_a_rover_that_does_not_say_where_it_is_takes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fault = {"fault": "sensor_stop", "target": "sensor/pose"}
    async with rover(monkeypatch, 0.0, faults=[fault]) as served:
        watcher = served.client(OPERATOR)
        await watcher.subscribe("/sensor/pose")
        await watcher.notice("stale")
        assert await sent(served, 2.0, 1.0) == "precondition_failed"
