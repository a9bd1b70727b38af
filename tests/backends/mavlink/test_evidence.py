"""What proves nothing: values that are no numbers, an old heartbeat, a command that has gone silent."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import pytest

from backends.mavlink.puppet import Puppet, station
from rcp_gateway.testing import eventually

GUIDED, LOITER, BRAKE = 4, 5, 17
RUNNING, DENIED = 5, 2


class Aloft(Puppet):
    """In the air, with local positions alone."""

    def __init__(self, speed: float) -> None:
        super().__init__()
        self.mode, self.armed, self.landed, self.speed = BRAKE, True, 2, speed
        self.results[176] = lambda _: 0
        self.also.append(
            lambda: super(Aloft, self).send(
                "LOCAL_POSITION_NED", self.clock, 0.0, 0.0, -10.0, self.speed, 0.0, 0.0
            )
        )

    def send(self, name: str, *fields: Any) -> None:
        if name != "GLOBAL_POSITION_INT":
            super().send(name, *fields)


@pytest.mark.parametrize(("speed", "at_rest"), [(0.0, True), (math.nan, None), (math.inf, None)])
async def test_a_speed_that_is_no_number_is_no_rest(speed: float, *, at_rest: bool | None) -> None:
    async with station(Aloft(speed)) as found:
        robot, began = found.robot, time.monotonic()
        seen = robot.vehicle.received_at
        await eventually(
            lambda: _is(seen.get("LOCAL_POSITION_NED", 0.0) > began + 1.5), "it has told enough"
        )
        assert robot.stop.state().at_rest is at_rest


async def test_an_attitude_has_no_heading_that_is_no_number() -> None:
    puppet = Puppet()
    puppet.mode, puppet.armed, puppet.landed, puppet.heading = GUIDED, True, 2, 1.0
    puppet.also.append(
        lambda: puppet.send("ATTITUDE", puppet.clock, 0.0, 0.0, math.nan, 0.0, 0.0, 0.0)
    )
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "aloft")
        body = {"roll": 0.1, "pitch": 0.0, "thrust": 0.5}
        done = await found.write("actuator/attitude", body, valid_for=5.0)
        assert done["status"] == "completed", done
        await eventually(lambda: _is(puppet.messages("SET_ATTITUDE_TARGET")), "it is commanded")
        assert all(map(math.isfinite, puppet.messages("SET_ATTITUDE_TARGET")[0].q))


async def test_a_mode_that_an_old_heartbeat_shows_is_set_all_the_same() -> None:
    puppet = Puppet()
    puppet.mode, modes = LOITER, [LOITER]

    def set_mode(message: Any) -> int:
        modes.append(int(message.param2))
        return 0

    puppet.results[176] = set_mode
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.mode == "LOITER"), "it is seen")
        reply = await found.do("action/set_mode", {"mode": "LOITER"})
        assert reply["status"] == "completed", reply
        assert modes == [LOITER, LOITER]


def begins(puppet: Puppet) -> None:
    """Have it begin a command, and tell nothing more about it."""

    def take(message: Any) -> None:
        if message.command == 211:
            puppet.send("COMMAND_ACK", 211, RUNNING, 40, 0, 255, 190)

    puppet.on["COMMAND_LONG"] = take


async def test_a_command_in_progress_that_goes_silent_is_not_sent_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_mavlink.commands._PATIENCE", 0.5)
    async with station(Puppet()) as found:
        begins(found.puppet)
        reply = await found.do("service/command", {"command": "DO_GRIPPER"})
        assert reply["status"] == "failed", reply
        assert reply["error"]["code"] == "device_timeout"
        assert "began it" in reply["message"]
        assert len(found.puppet.commands(211)) == 1


async def test_a_late_end_of_a_silent_command_is_not_that_of_the_next_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_mavlink.commands._PATIENCE", 0.5)
    async with station(Puppet()) as found:
        puppet, later = found.puppet, asyncio.get_running_loop().call_later
        begins(puppet)
        body = {"command": "DO_GRIPPER"}
        first = await found.do("service/command", body)
        assert first["status"] == "failed", first

        def answer(message: Any) -> None:
            if message.command == 211:
                later(0.15, puppet.send, "COMMAND_ACK", 211, DENIED, 0, 0, 255, 190)

        puppet.on["COMMAND_LONG"] = answer
        later(0.1, puppet.send, "COMMAND_ACK", 211, 0, 0, 0, 255, 190)  # of the first
        second = await found.do("service/command", body)
        assert second["status"] == "rejected", second


async def test_a_loss_that_could_not_be_told_is_told_again() -> None:
    async with station(Puppet()) as found:
        hub, told = found.served.life.backend.hub, list[bool]()

        def changed(vehicle: Any) -> None:
            told.append(vehicle.lost)
            if len(told) == 1:
                raise KeyError("a listener")

        hub.changed = changed
        found.puppet.quiet = True
        await eventually(lambda: _is(told == [True, True]), "it is told again", 20.0)
        found.puppet.quiet = False
        await eventually(lambda: _is(told == [True, True, False]), "it is back", 20.0)


async def test_a_command_in_progress_ends_with_the_link() -> None:
    async with station(Puppet()) as found:
        begins(found.puppet)
        path, body = "/tenant/t/service/command", {"command": "DO_GRIPPER"}
        id_ = await found.client.send(type="execute", path=path, body=body)
        await eventually(lambda: _is(found.puppet.commands(211)), "it has begun")
        found.puppet.quiet, began = True, time.monotonic()
        while (reply := await found.client.reply(id_, 30.0))["status"] in (
            "accepted",
            "in_progress",
        ):
            pass
        assert reply["status"] == "failed", reply
        assert time.monotonic() - began < 10.0


async def test_a_link_that_fails_does_not_end_the_watch_over_the_vehicle() -> None:
    async with station(Puppet()) as found:
        hub, vehicle = found.served.life.backend.hub, found.robot.vehicle
        failed: list[bytes] = []

        def fail(frame: bytes) -> None:
            failed.append(frame)
            raise RuntimeError("the handle is closed")

        for link in hub.links:
            link.send_all = fail
        await eventually(lambda: _is(failed), "a heartbeat was to be sent")
        found.puppet.quiet = True
        await eventually(lambda: _is(vehicle.lost), "its silence is noticed")


async def test_an_answer_to_another_ground_station_is_none_to_ours() -> None:
    async with station(Puppet()) as found:
        puppet = found.puppet

        def take(_: Any) -> int:
            puppet.send("COMMAND_ACK", 211, DENIED, 0, 0, 254, 190)
            puppet.send("COMMAND_ACK", 211, DENIED, 0, 0, 255, 230)
            return 0

        puppet.results[211] = take
        reply = await found.do("service/command", {"command": "DO_GRIPPER"})
        assert reply["status"] == "completed", reply


async def _is(truth: object) -> bool:
    return bool(truth)
