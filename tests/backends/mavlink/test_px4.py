"""A vehicle with PX4: modes in two bytes, integers by their bits, heights from the sea, set-points first."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from backends.mavlink.puppet import LAT, PX4, Puppet, Station, station
from rcp_gateway.testing import eventually
from rcp_mavlink.flightmodes import family
from rcp_mavlink.paramcoding import decoded, param_set

HOLD, TAKEOFF, LAND, RTL, MISSION = (4 << 16 | sub << 24 for sub in (3, 2, 6, 5, 4))
OFFBOARD, POSCTL = 6 << 16, 3 << 16


class Px4(Puppet):
    """It arms, takes off and goes where it is told within a tick or two."""

    def __init__(self, type_: int = 2) -> None:
        super().__init__(autopilot=PX4, type_=type_)
        self.mode = POSCTL
        self.fit = True
        self.params = {
            "MPC_XY_CRUISE": (5.0, 9), "COM_RC_IN_MODE": (3, 6), "MAV_TYPE": (-5_000_000, 6)
        }  # fmt: skip
        self.goal: tuple[float, float, float] | None = None
        self.results = {
            176: self._mode, 400: self._arm, 22: self._take_off, 192: self._reposition,
            300: lambda _: 0,
        }  # fmt: skip
        self.setpoints = 0
        self.on["SET_POSITION_TARGET_LOCAL_NED"] = self._setpoint
        self.also.append(self._fly)

    def _mode(self, command: Any) -> int:
        mode = int(command.param2) << 16 | int(command.param3) << 24
        if mode == OFFBOARD and self.setpoints < 3:
            self.say("Switching to mode 'Offboard' is currently not available")
            return 1
        self.mode = mode
        self.goal = (0.0, 0.0, 0.0) if mode in (LAND, RTL) else None
        return 0

    def _arm(self, command: Any) -> int:
        if command.param1 and not self.fit:
            self.say("Preflight Fail: Compass #0 uncalibrated")
            return 1
        self.armed = bool(command.param1)
        return 0

    def _take_off(self, command: Any) -> int:
        if not math.isnan(command.param5):
            return 2
        self.mode, self.landed = TAKEOFF, 2
        self.goal = (0.0, 0.0, command.param7 - self.sea)
        return 0

    def _reposition(self, command: Any) -> int:
        if command.get_type() == "COMMAND_LONG":  # to nowhere: it pauses where it is
            assert all(math.isnan(p) for p in (command.param5, command.param6, command.param7))
            self.mode, self.goal = HOLD, None
            return 0
        assert command.frame == 5
        self.mode = HOLD
        self.goal = ((command.x / 1e7 - LAT) * 111_319.49, 0.0, command.z - self.sea)
        return 0

    def _setpoint(self, message: Any) -> None:
        self.setpoints += 1
        if self.mode == OFFBOARD:
            self.velocity = (message.vx, message.vy, message.vz)

    def _fly(self) -> None:
        if self.mode != OFFBOARD:
            self.velocity = (0.0, 0.0, 0.0)
        if self.goal is not None:
            self.move(*self.goal)
            if self.mode == TAKEOFF:
                self.mode = HOLD
            self.landed = 2 if self.height > 0.1 else 1
            if self.landed == 1 and self.mode in (LAND, RTL):
                self.armed = False
            self.goal = None


@asynccontextmanager
async def px4(**more: Any) -> AsyncGenerator[tuple[Station, Px4]]:
    puppet = Px4(**more)
    async with station(puppet) as found:
        yield found, puppet


async def airborne(found: Station, puppet: Px4) -> None:
    puppet.armed, puppet.landed, puppet.mode = True, 2, HOLD
    puppet.move(0.0, 0.0, 20.0)

    async def seen() -> bool:
        vehicle = found.robot.vehicle
        return vehicle.landed is False and vehicle.home is not None and vehicle.mode == "HOLD"

    await eventually(seen, "it is seen in the air")


async def test_it_is_armed_flown_and_landed() -> None:
    async with px4() as (found, puppet):
        assert await found.read("sensor/mode") == "POSCTL"
        info = await found.read("sensor/vehicle")
        assert (info["autopilot"], info["kind"]) == ("px4", "copter")
        assert (await found.do("action/arm"))["status"] == "completed"
        risen = await found.do("action/takeoff", {"altitude": 12})
        assert risen["status"] == "completed", risen
        (order,) = puppet.commands(22)
        assert order.param7 == pytest.approx(412.0)
        assert all(math.isnan(p) for p in (order.param4, order.param5, order.param6))
        moved = await found.do("action/move_to", {"north": 30.0, "altitude": 15})
        assert moved["status"] == "completed", moved
        assert math.isnan(puppet.commands(192)[0].param4), "it keeps its heading"
        assert puppet.height == pytest.approx(15.0, abs=0.01)
        assert (await found.do("action/land"))["status"] == "completed"
        assert puppet.mode == LAND
        assert not puppet.armed


async def test_a_refusal_to_arm_carries_its_words_and_can_be_read() -> None:
    async with px4() as (found, puppet):
        puppet.fit, puppet.health = False, 0
        reply = await found.do("action/arm")
        assert reply["error"]["code"] == "device_rejected"
        assert reply["message"] == (
            "arm: temporarily rejected: Preflight Fail: Compass #0 uncalibrated"
        )

        async def told() -> bool:
            state = await found.read("sensor/prearm")
            return not state["ready"] and state["reasons"] == ["Compass #0 uncalibrated"]

        await eventually(told, "it can be read")


async def test_integers_go_by_their_bits() -> None:
    async with px4() as (found, puppet):

        async def there() -> bool:
            reply = await found.client.request("read", "/tenant/t/param/COM_RC_IN_MODE")
            return reply["status"] == "completed" and reply["body"] == 3

        await eventually(there, "the parameters are there")
        written = await found.write("param/COM_RC_IN_MODE", 7)
        assert written["status"] == "completed", written
        assert puppet.params["COM_RC_IN_MODE"][0] == 7
        (message,) = puppet.messages("PARAM_SET")
        assert struct.pack("<f", message.param_value) == (7).to_bytes(4, "little")
        assert (await found.write("param/MPC_XY_CRUISE", 8.5))["status"] == "completed"
        assert puppet.params["MPC_XY_CRUISE"][0] == 8.5


async def test_a_velocity_is_led_in_after_set_points_and_handed_back_at_rest() -> None:
    async with px4() as (found, puppet):
        await airborne(found, puppet)
        reply = await found.write("actuator/velocity", {"x": 2.0, "y": 1.0}, valid_for=1.0)
        assert reply["status"] == "completed", reply
        assert puppet.mode == OFFBOARD
        await eventually(lambda: _is(puppet.velocity == (2.0, -1.0, 0.0)), "it is led")
        await eventually(lambda: _is(puppet.mode == HOLD), "the dead-man hands it back")


async def test_offboard_is_entered_and_left_by_name() -> None:
    async with px4() as (found, puppet):
        await airborne(found, puppet)
        reply = await found.do("action/set_mode", {"mode": "OFFBOARD"})
        assert reply["status"] == "completed", reply
        assert puppet.mode == OFFBOARD
        assert (await found.do("action/set_mode", {"mode": "HOLD"}))["status"] == "completed"
        puppet.mode = POSCTL

        await eventually(lambda: _is(found.robot.vehicle.mode == "POSCTL"), "it is seen")
        reply = await found.write("actuator/velocity", {"x": 1.0})
        assert reply["error"]["code"] == "mode_forbids"


async def test_a_mission_is_paused_and_gone_on_with_by_its_modes() -> None:
    async with px4() as (found, puppet):
        await airborne(found, puppet)
        puppet.also.append(lambda: puppet.send("MISSION_CURRENT", 1, 3, 3, 1))
        id_ = await found.client.send(type="execute", path="/tenant/t/action/mission/run")
        await eventually(lambda: _is(puppet.mode == MISSION), "it flies")
        await eventually(lambda: _is(found.robot.vehicle.mode == "MISSION"), "it is seen")
        assert (await found.do("action/mission/pause"))["status"] == "completed"
        assert puppet.mode == HOLD
        assert (await found.client.final(id_))["status"] == "failed"
        assert (await found.do("action/mission/resume"))["status"] == "completed"
        assert puppet.mode == MISSION


async def test_an_estop_makes_it_hold() -> None:
    async with px4() as (found, puppet):
        await airborne(found, puppet)
        puppet.mode = MISSION
        async with asyncio.timeout(60):
            stop = await found.client.request("execute", "/system/estop", within=60.0)
        assert stop["status"] == "completed", stop
        assert puppet.mode == HOLD
        assert puppet.commands(192), "HOLD alone does not end what goes to a place in HOLD"


@given(
    value=st.integers(-(2**31), 2**31 - 1)
    | st.integers(-8_388_607, -4_194_305)  # as floats they would be signalling NaNs
)
def test_every_integer_survives_its_way_through_a_float(value: int) -> None:
    message, told = param_set(mav, (1, 1), "P", value, 6, bytewise=True)
    assert told == value
    frame = message.pack(mav.MAVLink(None, 255, 190))
    assert frame[10:14] == value.to_bytes(4, "little", signed=True)
    assert decoded(bytes(frame[10:14]), 6, bytewise=True) == value


def test_mode_numbers_are_those_of_pymavlink() -> None:
    ours = family(PX4, 2)
    for name, (_, main, sub) in mavutil.px4_map.items():
        known = {"LOITER": "HOLD", "FOLLOWME": "FOLLOW", "RTGS": None}.get(name, name)
        if known is not None and ours.number(known) is not None:
            assert ours.number(known) == int(main) << 16 | int(sub) << 24, name


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
