"""A rover leaves AUTO at the end of its mission, and its heartbeat may tell so before its mission does."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.mavlink.puppet import station
from backends.mavlink.test_kinds import ROVER, Kind
from rcp_gateway.testing import eventually

AUTO, HOLD, RTL = 10, 4, 11
ACTIVE, COMPLETE = 3, 5


class Rover(Kind):
    """It has a mission of two items, and is at the last one."""

    def __init__(self) -> None:
        super().__init__(ROVER)
        self.armed, self.seq, self.state = True, 2, ACTIVE
        self.results[300] = lambda _: 0
        self.also.append(self._tell)

    def _tell(self) -> None:
        self.send("MISSION_CURRENT", self.seq, 2, self.state, 1)


@pytest.mark.parametrize(
    ("seq", "mode", "end", "status"),
    [
        (2, HOLD, COMPLETE, "completed"),
        (2, RTL, ACTIVE, "failed"),
        (1, HOLD, COMPLETE, "failed"),
    ],
)
async def test_a_mission_is_over_when_it_says_so_and_not_by_its_mode(
    seq: int, mode: int, end: int, status: str
) -> None:
    puppet = Rover()
    async with station(puppet) as found:
        vehicle = found.robot.vehicle
        await eventually(lambda: _is(vehicle.armed), "it is seen to be armed")
        ask = asyncio.create_task(found.do("action/mission/run"))
        await eventually(lambda: _is(vehicle.mode == "AUTO"), "it is under way")
        await eventually(lambda: _is(bool(puppet.commands(300))), "it is told to begin")
        puppet.seq, puppet.mode = seq, mode
        await eventually(lambda: _is(vehicle.mode_number == mode), "it has left the mode")
        if seq == 2:
            puppet.state = end
        reply = await ask
        assert reply["status"] == status, reply


async def _is(truth: Any) -> bool:
    return bool(truth)
