"""Any command of the dialect by its name, but none around a path that has checks of its own."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.puppet import Puppet, station
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN
from rcp_mavlink.direct_commands import allowed

FREE = {"SERVO9_FUNCTION": 0.0, "SERVO10_FUNCTION": 73.0, "RELAY2_FUNCTION": 1.0}


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    commands = ["*", "DO_SET_HOME"]
    async with flying({"parameters": {"DISARM_DELAY": 0.0, **FREE}}, commands=commands) as found:
        await found.ready()
        yield found


async def test_a_servo_and_a_relay_are_set_and_seen(pilot: Pilot) -> None:
    done = await pilot.do(
        "service/command", {"command": "DO_SET_SERVO", "params": {"instance": 9, "pwm": 1600}}
    )
    assert done["status"] == "completed", done
    assert done["body"] == {"command": "DO_SET_SERVO", "params": [9, 1600, 0, 0, 0, 0, 0]}
    assert pilot.vehicle.outputs.pulses == {9: 1600}
    assert (await pilot.read("sensor/servos"))["servo9_raw"] == 1600
    relay = {"command": "MAV_CMD_DO_SET_RELAY", "params": {"instance": 1, "param2": 1}}
    assert (await pilot.do("service/command", relay))["status"] == "completed"
    assert pilot.vehicle.outputs.relays == 0b10


async def test_what_the_vehicle_refuses_is_told(pilot: Pilot) -> None:
    reply = await pilot.do(
        "service/command", {"command": "DO_SET_SERVO", "params": {"instance": 10, "pwm": 1600}}
    )
    assert reply["error"]["code"] == "device_rejected"
    assert reply["message"].startswith("DO_SET_SERVO: failed")
    assert pilot.vehicle.outputs.pulses == {}
    relay = {"command": "DO_SET_RELAY", "params": {"instance": 0, "setting": 1}}
    assert (await pilot.do("service/command", relay))["error"]["code"] == "device_rejected"


async def test_a_position_is_sent_in_whole_numbers(pilot: Pilot) -> None:
    place = {"latitude": LAT + 1e-4, "longitude": LON, "altitude": 580.0}
    done = await pilot.do(
        "service/command", {"command": "DO_SET_HOME", "params": place, "frame": "absolute"}
    )
    assert done["status"] == "completed", done
    assert pilot.vehicle.home == pytest.approx((LAT + 1e-4, LON, 580.0), abs=1e-6)


@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        ({"command": "DO_SET_SERV0"}, "Did you mean DO_SET_SERVO"),
        ({"command": "DO_SET_SERVO", "params": {"pmw": 1}}, "Did you mean pwm?"),
        ({"command": "DO_SET_SERVO", "params": {"zzz": 1}}, "It has instance, pwm."),
        ({"command": "DO_SET_SERVO", "params": {"pwm": 1, "param2": 2}}, ""),
        ({"command": "DO_REPOSITION"}, "Use action/move_to."),
        ({"command": "COMPONENT_ARM_DISARM"}, "Use action/arm or action/disarm."),
        ({"command": "NAV_TAKEOFF"}, "Use action/takeoff"),
        ({"command": "DO_FLIGHTTERMINATION"}, '`commands = ["DO_FLIGHTTERMINATION"]`'),
        ({"command": "DO_AUX_FUNCTION"}, '`commands = ["DO_AUX_FUNCTION"]`'),
        ({"command": "DO_SET_HOME", "params": {"latitude": None, "longitude": 8}}, "in degrees"),
        ({"command": "DO_SET_HOME", "params": {"latitude": 91, "longitude": 8}}, "-90 to 90"),
        ({"command": "DO_SET_HOME", "params": {"param5": 47, "longitude": 300}}, "-180 to 180"),
        ({"command": "DO_SET_ROI_LOCATION", "params": {"latitude": 47}}, "-180 to 180"),
        ({"command": "DO_SET_SERVO", "params": {"instance": 1, "pwm": 3.5e38}}, ""),
    ],
)
async def test_what_is_wrong_is_refused_and_nothing_is_sent(
    given: dict[str, Any], remedy: str
) -> None:
    async with station(Puppet(), commands=["*", "DO_SET_HOME"]) as scene:
        before = len(scene.puppet.got)
        reply = await scene.do("service/command", given)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_value"), reply
        assert remedy in reply["error"]["remedy"]
        sent = scene.puppet.got[before:]
        assert {m.command for m in sent if m.get_type().startswith("COMMAND_")} <= {
            511,
            512,
            520,
        }  # what the gateway asks for


async def test_null_is_nan_and_what_is_missing_is_zero() -> None:
    async with station(Puppet()) as scene:
        scene.puppet.results[183] = lambda _: 0
        given = {"command": "DO_SET_SERVO", "params": {"instance": 3, "pwm": None}}
        assert (await scene.do("service/command", given))["body"]["params"][1] is None
        (message,) = scene.puppet.commands(183)
        assert (message.param1, message.param3) == (3.0, 0.0)
        assert math.isnan(message.param2)


async def test_home_is_set_where_the_vehicle_is_without_a_position() -> None:
    async with station(Puppet(), commands=["DO_SET_HOME"]) as scene:
        scene.puppet.results[179] = lambda _: 0
        given = {"command": "DO_SET_HOME", "params": {"use_current": 1}}
        assert (await scene.do("service/command", given))["status"] == "completed"
        given["params"] = {"use_current": 1, "latitude": None}
        reply = await scene.do("service/command", given)
        assert reply["error"]["code"] == "invalid_value"  # no whole number says "unchanged"
        assert len(scene.puppet.commands(179)) == 1


@pytest.mark.parametrize("params", [{"param5": None}, {"param6": 3e9}, {"param5": 0.5}])
async def test_what_is_no_whole_number_is_not_repeated_as_one(params: dict[str, Any]) -> None:
    """A gripper that is unsupported as COMMAND_LONG."""
    async with station(Puppet()) as scene:
        reply = await scene.do("service/command", {"command": "DO_GRIPPER", "params": params})
        assert reply["error"]["code"] == "device_rejected", reply
        assert "unsupported" in reply["message"]
        assert [each.get_type() for each in scene.puppet.commands(211)] == ["COMMAND_LONG"]


async def test_no_command_is_sent_to_everybody() -> None:
    async with station(Puppet()) as scene:
        reply = await scene.do("service/command", {"command": "DO_GRIPPER", "component": 0})
        assert reply["error"]["code"] == "out_of_range"
        assert not scene.puppet.commands(211)


RUNNING, DENIED = 5, 2


async def test_a_refusal_after_it_is_in_progress_is_a_failure() -> None:
    """Without a percentage too: 255 is unknown."""
    async with station(Puppet()) as scene:
        puppet = scene.puppet

        def begin(_: Any) -> int:
            puppet.send("COMMAND_ACK", 211, RUNNING, 255, 0, 255, 190)
            return DENIED

        puppet.results[211] = begin
        reply = await scene.do("service/command", {"command": "DO_GRIPPER"})
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected"), reply


@pytest.mark.parametrize("running", [True, False])
async def test_a_cancel_is_told_to_a_vehicle_that_is_at_it(*, running: bool) -> None:
    async with station(Puppet(), timeout=30.0) as scene:
        puppet = scene.puppet
        puppet.on["COMMAND_LONG"] = lambda m: (
            puppet.send("COMMAND_ACK", 211, RUNNING, 40, 0, 255, 190)
            if m.command == 211 and running
            else None
        )
        command = await scene.client.send(
            type="execute", path="/tenant/t/service/command", body={"command": "DO_GRIPPER"}
        )
        accepted = await scene.client.reply(command, 30.0)
        if running:
            assert (await scene.client.reply(command, 30.0))["progress"] == 0.4
        else:
            await eventually(lambda: _is(bool(puppet.commands(211))), "the command is sent")
        await scene.client.request("cancel", command=accepted["command"])
        while (reply := await scene.client.reply(command, 30.0))["status"] == "in_progress":
            pass
        assert reply["status"] == "cancelled", reply
        if running:
            await eventually(lambda: _is(len(cancels(puppet)) == 1), "the cancel is told")
            assert bytes(cancels(puppet)[0].data[10:14]) == bytes((211, 0, 1, 1))
        puppet.on.clear()  # what is sent next comes after what was sent before
        await scene.do("service/command", {"command": "DO_SPRAYER"})
        assert len(cancels(puppet)) == int(running)


def cancels(puppet: Puppet) -> list[Any]:
    return [
        message for message in puppet.got if message.get_type() == "UNKNOWN_80"
    ]  # COMMAND_CANCEL


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth


async def test_the_list_shows_what_may_be_sent_with_names_and_descriptions(pilot: Pilot) -> None:
    listed = (await pilot.do("service/commands"))["body"]
    names = {each["command"] for each in listed}
    assert {"DO_SET_SERVO", "DO_SET_HOME", "DO_GRIPPER"} <= names
    assert not names & {"DO_REPOSITION", "NAV_WAYPOINT", "DO_FLIGHTTERMINATION"}
    (servo,) = (await pilot.do("service/commands", {"name": "DO_SET_SERVO"}))["body"]
    assert [(p["name"], p["number"]) for p in servo["params"]] == [("instance", 1), ("pwm", 2)]
    assert servo["description"] == "Set a servo to a desired PWM value."


async def test_nothing_is_sent_while_a_stop_is_latched(pilot: Pilot) -> None:
    admin = pilot.served.client(ADMIN)
    await admin.request("execute", "/system/estop")
    given = {"command": "DO_SET_SERVO", "params": {"instance": 9, "pwm": 1600}}
    reply = await pilot.do("service/command", given)
    assert reply["error"]["code"] == "estop_active"
    assert pilot.vehicle.outputs.pulses == {}


async def test_no_commands_means_no_path() -> None:
    async with station(Puppet(), commands=[]) as scene:
        reply = await scene.do("service/command", {"command": "DO_SET_SERVO"})
        assert reply["error"]["code"] == "unknown_path"


def test_patterns_allow_only_what_is_harmless() -> None:
    for name in ("DO_SET_RELAY", "DO_GIMBAL_MANAGER_PITCHYAW", "REQUEST_MESSAGE", "LOGGING_START"):
        assert allowed(name, ("*",)), name
    assert allowed("DO_SET_SERVO", ("DO_SET_*",))
    assert not allowed("DO_GRIPPER", ("DO_SET_*",))
    for name in (
        "DO_PARACHUTE", "DO_AUX_FUNCTION", "SOLO_BTN_FLY_CLICK", "ACTUATOR_TEST", "DO_SET_STANDARD_MODE",
        "DO_SET_MISSION_CURRENT", "DO_CHANGE_ALTITUDE", "DO_SET_PARAMETER", "DO_FENCE_ENABLE", "DO_SET_HOME",
        "EXTERNAL_POSITION_ESTIMATE", "FLASH_BOOTLOADER", "POWER_OFF_INITIATED", "REQUEST_OPERATOR_CONTROL", "NEW_ONE",
    ):  # fmt: skip
        assert not allowed(name, ("*", "*_*", f"{name[:-1]}?")), name
        assert allowed(name, (name,)), name
    assert not allowed("DO_REPOSITION", ("DO_REPOSITION",))
    assert not allowed("NAV_LAND", ("*", "NAV_LAND"))
