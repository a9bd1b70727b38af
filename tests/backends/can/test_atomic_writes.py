"""Set-points of several motors written as one: sent in one cycle, or not at all."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import can
import pytest

import rcp_can
from backends.can.rig import Node, channel
from rcp_can.sim import Bench, make_twin
from rcp_gateway.testing import OPERATOR, eventually, serve_backend
from rcp_gateway.testing._client import Client

KIND = next(iter(rcp_can.rcp_backends()))
NODES = {"left": 1, "right": 2}
WHEELS = {f"/tenant/t/actuator/{name}/velocity": 1.0 for name in NODES}
RIGHT = "/tenant/t/actuator/right/velocity"
_VELOCITY = 0x0D  # ODrive: Set_Input_Vel
_IDENTIFIERS = {node << 5 | _VELOCITY: name for name, node in NODES.items()}


class Wheels:
    """Two drives on a bus, in a gateway, and what they are sent."""

    def __init__(self, client: Client, bench: Bench, node: Node) -> None:
        self.client = client
        self.twins = dict(zip(NODES, bench.twins, strict=True))
        self._node = node

    async def enable(self, *names: str) -> None:
        for name in names:
            done = await self.client.request("execute", f"/tenant/t/service/{name}/enable")
            assert done["status"] == "completed", done

    async def write(self, values: dict[str, float] = WHEELS, **fields: Any) -> dict[str, Any]:
        return await self.client.request("write", body=values, **fields)

    def sent(self) -> list[str]:
        """Return whose velocities have been sent since this was asked last, in order."""
        found: list[str] = []
        while (message := self._node.bus.recv(0)) is not None:
            if message.arbitration_id in _IDENTIFIERS:
                found.append(_IDENTIFIERS[message.arbitration_id])
        return found

    async def rests(self) -> bool:
        return all(abs(twin.plant.velocity) < 0.05 for twin in self.twins.values())

    async def turns(self) -> bool:
        return all(abs(twin.plant.velocity - 1.0) < 0.1 for twin in self.twins.values())


@pytest.fixture
async def wheels() -> AsyncGenerator[Wheels]:
    async with running() as found:
        yield found


@asynccontextmanager
async def running() -> AsyncGenerator[Wheels]:
    name = channel()
    line = can.Bus(name, "virtual", ignore_config=True)
    motor = {"bus": "can0", "profile": "odrive", "velocity": 4.0, "rate": 50}
    motor |= {"timeout": 1.0, "feedback_timeout": 1.0}  # on a machine that does much else
    table = {
        "buses": {"can0": {"interface": "virtual", "channel": name}},
        "motors": {wheel: {**motor, "node": node} for wheel, node in NODES.items()},
    }
    with Bench(line, [make_twin("odrive", node) for node in NODES.values()]) as bench:
        async with serve_backend(KIND, table) as served:
            await asyncio.wait_for(served.supervisor.settled.wait(), 60)
            with Node(name) as node:
                yield Wheels(served.client(OPERATOR), bench, node)


async def test_two_wheels_get_their_velocities_in_one_cycle(wheels: Wheels) -> None:
    await wheels.enable("left", "right")
    for _ in range(3):
        wheels.sent()
        assert (await wheels.write(valid_for=30.0))["status"] == "completed"
        await eventually(wheels.turns, "both turn")
        sent = wheels.sent()
        assert {*sent[:2]} == {"left", "right"}, sent[:6]
        assert (await wheels.write(dict.fromkeys(WHEELS, 0.0)))["status"] == "completed"
        await eventually(wheels.rests, "both rest")


async def test_nothing_is_sent_while_one_drive_is_off(wheels: Wheels) -> None:
    await wheels.enable("left")
    wheels.sent()
    refused = await wheels.write()
    assert (refused["error"]["code"], refused["error"]["path"]) == ("mode_forbids", RIGHT)
    assert await wheels.rests()
    assert wheels.sent() == []


async def test_nothing_is_sent_while_one_drive_is_silent(wheels: Wheels) -> None:
    await wheels.enable("left", "right")
    wheels.twins["right"].silent = True
    client = wheels.client

    async def lost() -> bool:
        state = await client.request("read", "/tenant/t/sensor/right/motion", body={"fresh": True})
        return "error" in state

    await eventually(lost, "its silence is noticed")
    refused = await wheels.write()
    assert refused["error"]["path"] == RIGHT
    assert refused["error"]["code"] in ("adapter_unavailable", "device_timeout")
    assert abs(wheels.twins["left"].plant.velocity) < 0.05


async def test_both_come_to_rest_when_their_time_is_over(wheels: Wheels) -> None:
    await wheels.enable("left", "right")
    assert (await wheels.write(valid_for=0.5))["status"] == "completed"
    await eventually(wheels.turns, "both turn")
    await eventually(wheels.rests, "both rest")


async def test_modes_are_not_mixed(wheels: Wheels) -> None:
    found = await wheels.client.request("discover", "/tenant/t/actuator/**")
    groups = {one["path"].rpartition("/")[2]: one["atomic"] for one in found["body"]["resources"]}
    assert groups["velocity"] == "velocity at 50 Hz"
    mixed = {RIGHT: 0.5, "/tenant/t/actuator/right/torque": 0.1}
    assert (await wheels.write(mixed))["error"]["code"] == "not_implemented"
