"""A reboot is over when the vehicle has restarted, not when it still goes on after it has accepted."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.mavlink.puppet import Puppet, station
from rcp_gateway.testing import eventually
from rcp_mavlink import restart

_GOES_ON = 1.5  # s after the acknowledgement, with heartbeats


class Restarting(Puppet):
    """It accepts a reboot, goes on, and then restarts in one way or another."""

    def __init__(self, way: str) -> None:
        super().__init__()
        self.way, self.restarted = way, False
        self.results = {246: self._reboot}

    def _reboot(self, _: Any) -> int:
        if self.way != "not at all":
            asyncio.get_running_loop().call_later(_GOES_ON, self._go)
        return 0

    def _go(self) -> None:
        self.quiet = self.way != "by its clock"
        pause = 4.0 if self.quiet else 0.0
        asyncio.get_running_loop().call_later(pause, self._come)

    def _come(self) -> None:
        self.quiet, self.restarted = False, True
        if self.way == "by its clock":
            self.booted = asyncio.get_running_loop().time()


@pytest.mark.parametrize("service", ["service/reboot", "service/reset_system"])
@pytest.mark.parametrize(
    ("way", "silence"), [("by its clock", 9.0), ("by a pause", 9.0), ("by a pause", 1.5)]
)
async def test_a_reboot_ends_when_the_vehicle_has_restarted(
    way: str, silence: float, service: str
) -> None:
    puppet = Restarting(way)
    async with station(puppet, silence=silence) as found:
        reply = await found.do(service)
        assert reply["status"] == "completed", reply
        assert puppet.restarted


async def test_a_vehicle_that_only_accepts_a_reboot_has_not_rebooted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(restart, "_COMING_BACK", 2.0)
    async with station(Restarting("not at all")) as found:
        reply = await found.do("service/reboot")
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_timeout"), reply
        assert "has not restarted" in reply["message"]


GUIDED, AUTO, LAND = 4, 3, 9


def flying() -> Puppet:
    """Make a copter in the air that takes each mode, and starts its mission."""
    puppet = Puppet()
    puppet.armed, puppet.landed, puppet.mode, puppet.height = True, 2, GUIDED, 20.0

    def set_mode(message: Any) -> int:
        puppet.mode = int(message.param2)
        return 0

    puppet.results = {176: set_mode, 300: lambda _: 0}
    puppet.also.append(lambda: puppet.send("MISSION_CURRENT", 1, 2, 3, 1))
    return puppet


def restart_in_the_air(puppet: Puppet) -> None:
    """Have it begin anew: it says that it is disarmed on the ground until it knows better."""
    puppet.booted = asyncio.get_running_loop().time() - 1.0
    puppet.armed, puppet.landed = False, 1


async def _is(truth: object) -> bool:
    return bool(truth)


@pytest.mark.parametrize(
    ("action", "mode"), [("action/land", LAND), ("action/rtl", 6), ("action/mission/run", AUTO)]
)
@pytest.mark.parametrize("clock_last", [False, True])
async def test_a_restart_on_the_way_down_is_no_landing(
    action: str, mode: int, *, clock_last: bool
) -> None:
    puppet = flying()
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "it flies")
        asked = asyncio.create_task(found.do(action))
        await eventually(lambda: _is(puppet.mode == mode), "it is on its way")
        await eventually(lambda: _is(found.robot.vehicle.mode_number == mode), "it has said so")
        send = puppet.send
        if clock_last:  # its state comes before the first message with its clock
            held = asyncio.get_running_loop().time() + 1.0

            def without_clock(name: str, *fields: Any) -> None:
                late = asyncio.get_running_loop().time() > held
                if late or name != "GLOBAL_POSITION_INT":
                    send(name, *fields)

            puppet.send = without_clock  # type: ignore[method-assign]
        restart_in_the_air(puppet)
        reply = await asked
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_timeout"), reply
        assert "restarted" in reply["message"]


async def test_a_landing_without_a_restart_is_one() -> None:
    puppet = flying()
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "it flies")
        asked = asyncio.create_task(found.do("action/land"))
        await eventually(lambda: _is(puppet.mode == LAND), "it is on its way")
        puppet.armed, puppet.landed, puppet.height = False, 1, 0.0
        reply = await asked
        assert reply["status"] == "completed", reply


async def test_a_landing_that_no_clock_confirms_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "_TOLD", 0.5)
    puppet = flying()
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "it flies")
        asked = asyncio.create_task(found.do("action/land"))
        await eventually(lambda: _is(puppet.mode == LAND), "it is on its way")
        send = puppet.send

        def without_clock(name: str, *fields: Any) -> None:
            if name != "GLOBAL_POSITION_INT":
                send(name, *fields)

        puppet.send = without_clock  # type: ignore[method-assign]
        puppet.armed, puppet.landed = False, 1
        reply = await asked
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_timeout"), reply


async def test_a_twin_on_the_ground_with_its_system_id_does_not_let_a_vehicle_be_reset() -> None:
    puppet = flying()
    async with station(puppet) as found:
        vehicle = found.robot.vehicle
        puppet.also.append(lambda: puppet.send("HEARTBEAT", 10, 3, 1, 0, 4, 3))
        await eventually(lambda: _is(vehicle.duplicated), "both are heard")
        puppet.armed = False  # as the heartbeats of one of the same kind say
        await eventually(lambda: _is(not vehicle.armed), "it seems disarmed")
        reply = await found.do("service/reset_system")
        assert reply["status"] == "rejected", reply
        assert not puppet.commands(246)
