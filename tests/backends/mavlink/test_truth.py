"""Every action ends: as telemetry shows, or by an error of its kind, whatever the vehicle does."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.mavlink.puppet import Puppet, Station, station
from rcp_gateway.testing import eventually

GUIDED, BRAKE = 4, 17
ITEM = {"items": [{"command": "NAV_WAYPOINT", "latitude": 47.0, "longitude": 8.0}]}
FLIGHTS = {
    "action/takeoff": {"altitude": 30.0},
    "action/land": None,
    "action/rtl": None,
    "action/move_to": {"north": 500.0, "altitude": 20.0},
    "action/mission/run": None,
}
OTHERS = {
    "action/gimbal": {"pitch": -0.5},
    "action/camera/photo": None,
    "action/mission/upload": ITEM,
    "service/mission/download": None,
    "service/log/list": None,
    "service/ftp/list": {"path": "/"},
    "service/param/read": {"name": "NOPE"},
}


class Idle(Puppet):
    """It says yes to everything, and does nothing of it but change its mode."""

    def __init__(self) -> None:
        super().__init__()
        self.mode, self.armed = GUIDED, True
        yes = dict.fromkeys((22, 205, 300, 192, 203), lambda _: 0)
        self.results = {**yes, 176: self._mode, 400: self._arm}
        self.also.append(lambda: self.send("MISSION_CURRENT", 1, 3, 3, 1))

    def _mode(self, command: Any) -> int:
        self.mode = int(command.param2)
        return 0

    def _arm(self, command: Any) -> int:
        self.armed = bool(command.param1)
        return 0

    def in_place(self, action: str) -> None:
        """Stand for a take-off, and fly for everything else."""
        self.landed = 1 if action == "action/takeoff" else 2
        self.move(100.0, 0.0, 0.0 if self.landed == 1 else 20.0)


async def begun(found: Station, puppet: Idle, action: str, **more: Any) -> Any:
    """Start an action and wait until the vehicle was told."""
    puppet.in_place(action)
    vehicle = found.robot.vehicle
    await eventually(
        lambda: _is(vehicle.landed == (puppet.landed == 1) and vehicle.home is not None), "seen"
    )
    del puppet.got[:]
    body = (FLIGHTS | OTHERS)[action]
    id_ = await found.client.send(type="execute", path=f"/tenant/t/{action}", body=body, **more)
    await eventually(lambda: _is(bool(puppet.got)), "it is told")
    return id_


@pytest.mark.parametrize("action", [*FLIGHTS, *OTHERS])
async def test_a_link_that_is_cut_ends_it_with_a_typed_error(action: str) -> None:
    puppet = Idle()
    async with station(puppet, silence=1.0) as found:
        id_ = await begun(found, puppet, action)
        puppet.quiet = True
        final = await found.client.final(id_)
        assert final["status"] in ("failed", "rejected")
        codes = {"adapter_unavailable", "device_timeout", "unknown_path"}
        assert final["error"]["code"] in codes, final
        if action in FLIGHTS:
            assert final["error"]["code"] == "adapter_unavailable"
        assert final["error"]["remedy"]
        puppet.quiet = False
        await eventually(lambda: _is(not found.robot.vehicle.lost), "it is back by itself")


@pytest.mark.parametrize(
    ("action", "body"), [("arm", None), ("disarm", None), ("set_mode", {"mode": "LOITER"})]
)
async def test_a_link_that_is_lost_after_the_vehicle_has_said_yes_is_no_refusal(
    action: str, body: Any
) -> None:
    """The motors may turn."""
    puppet = Idle()
    puppet.armed, puppet.landed = action == "disarm", 1
    puppet.results = {176: lambda _: 0, 400: lambda _: 0}
    async with station(puppet, silence=1.0) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is True), "seen")
        path = f"/tenant/t/action/{action}"
        id_ = await found.client.send(type="execute", path=path, body=body)
        while (await found.client.reply(id_))["status"] != "in_progress":
            continue
        puppet.quiet = True
        final = await found.client.final(id_)
        assert final["status"] == "failed", final
        assert final["error"]["code"] == "adapter_unavailable", final
        assert final["error"]["details"]["on_loss"] == "hold"


@pytest.mark.parametrize("action", FLIGHTS)
async def test_one_that_never_gets_there_ends_with_its_deadline_and_holds(action: str) -> None:
    puppet = Idle()
    async with station(puppet) as found:
        id_ = await begun(found, puppet, action, deadline=1.5)
        final = await found.client.final(id_)
        assert final["error"]["code"] == "deadline_exceeded", final
        if action != "action/takeoff":
            await eventually(lambda: _is(puppet.mode == BRAKE), "it holds")


@pytest.mark.parametrize("action", FLIGHTS)
async def test_one_that_is_cancelled_in_flight_holds(action: str) -> None:
    puppet = Idle()
    async with station(puppet) as found:
        id_ = await begun(found, puppet, action)
        puppet.landed = 2
        puppet.move(100.0, 0.0, 15.0)
        vehicle = found.robot.vehicle
        await eventually(lambda: _is(vehicle.landed is False), "it is in the air")
        while (await found.client.reply(id_))["status"] != "in_progress":
            continue
        await found.client.request("cancel", f"/tenant/t/{action}")
        assert (await found.client.final(id_))["status"] == "cancelled"
        await eventually(lambda: _is(puppet.mode == BRAKE), "it holds")


async def test_a_parameter_that_there_is_not_is_told_after_one_question() -> None:
    puppet = Idle()
    puppet.params = {"RTL_ALT": (1500.0, 4)}
    async with station(puppet) as found:
        robot = found.robot
        await eventually(lambda: _is(robot.parameters.complete.is_set()), "they are listed")
        async with asyncio.timeout(60.0):
            reply = await found.do("service/param/read", {"name": "RTL_ALTT"})
        assert reply["error"]["code"] == "unknown_path"
        assert "RTL_ALT" in reply["error"]["remedy"]
        assert len(puppet.messages("PARAM_REQUEST_READ")) == 1
        reply = await found.client.request("read", "/tenant/t/param/RTL_ALTT")
        assert reply["error"]["code"] == "unknown_path"


async def test_a_vehicle_that_says_why_a_parameter_cannot_be_is_heard() -> None:
    puppet = Idle()
    puppet.params = {"RTL_ALT": (1500.0, 4)}

    def refused(error: int) -> Any:
        return lambda m: puppet.send("PARAM_ERROR", 255, 190, m.param_id.encode(), -1, error)

    puppet.on["PARAM_SET"] = refused(5)
    async with station(puppet) as found:
        robot = found.robot
        await eventually(lambda: _is(robot.parameters.complete.is_set()), "they are listed")
        await eventually(
            lambda: _is("param/RTL_ALT" in found.served.supervisor.entries), "they are there"
        )
        reply = await found.write("param/RTL_ALT", 2000)
        assert reply["error"]["code"] == "device_rejected"
        assert "read-only" in reply["message"]
        puppet.on["PARAM_REQUEST_READ"] = refused(1)
        reply = await found.do("service/param/read", {"name": "GONE"})
        assert reply["error"]["code"] == "unknown_path"


async def test_an_answer_from_before_is_not_taken_for_the_value_that_was_set() -> None:
    puppet = Idle()
    puppet.params = {"RTL_ALT": (1500.0, 4)}
    take = puppet.take

    def slowly(message: Any) -> None:
        if message.get_type() == "PARAM_SET":
            puppet.tell("RTL_ALT")  # the old one, said a moment before
        take(message)

    puppet.take = slowly  # type: ignore[method-assign]
    async with station(puppet) as found:
        await eventually(
            lambda: _is("param/RTL_ALT" in found.served.supervisor.entries), "they are there"
        )
        reply = await found.write("param/RTL_ALT", 2000)
        assert reply["status"] == "completed", reply
        assert puppet.params["RTL_ALT"][0] == 2000


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
