"""Home, held positions, sticks, motors and payloads: done when the vehicle shows it, stopped with it."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.flying import airborne, armed, on_the_ground, skip, speed
from backends.mavlink.puppet import station
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from backends.mavlink.test_px4 import Px4
from backends.mavlink.test_px4 import airborne as px4_airborne
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN
from rcp_mavlink_sim.modes import Mode

WITH = {
    "SERVO9_FUNCTION": 0.0, "SERVO10_FUNCTION": 73.0, "RELAY2_FUNCTION": 1.0, "GRIP_ENABLE": 1.0,
    "WINCH_TYPE": 2.0, "CHUTE_ENABLED": 1.0, "DISARM_DELAY": 0.0,
}  # fmt: skip


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying({"parameters": WITH}, sticks=True) as found:
        await found.ready()
        yield found


async def write(pilot: Pilot, name: str, body: Any, **more: Any) -> Any:
    return await pilot.client.request("write", f"/tenant/t/{name}", body=body, **more)


async def estop(pilot: Pilot) -> None:
    reply = await pilot.served.client(ADMIN).request("execute", "/system/estop", within=60.0)
    assert reply["status"] == "completed", reply


def error(reply: Any) -> str:
    return reply["error"]["code"]


# Home and origin


async def test_home_is_moved_and_an_origin_is_kept(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    place = {"latitude": LAT + 1e-4, "longitude": LON, "altitude": 580.0}
    done = await pilot.do("service/home/set", place)
    assert done["status"] == "completed", done
    assert done["body"] == pytest.approx(place, abs=1e-6)
    assert vehicle.home == pytest.approx((LAT + 1e-4, LON, 580.0))
    assert (await pilot.do("service/home/set"))["body"]["latitude"] == pytest.approx(LAT, abs=1e-6)
    half = await pilot.do("service/home/set", {"latitude": 1.0})
    assert error(half) == "invalid_value"
    kept = await pilot.do("service/origin/set", place)
    assert error(kept) == "precondition_failed"
    assert "already has its origin" in kept["message"]
    vehicle.ekf_origin = None  # as after a boot without GPS
    moved = await pilot.do("service/origin/set", place)
    assert moved["status"] == "completed", moved
    assert vehicle.ekf_origin == pytest.approx((LAT + 1e-4, LON, 580.0))
    assert (await pilot.read("sensor/origin"))["latitude"] == pytest.approx(LAT + 1e-4)


# Held positions


async def test_a_position_is_held_and_ends_at_rest_when_it_is_not_repeated(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    airborne(vehicle)
    await pilot.ready()
    for target in (
        {"position": {"x": 0.0, "y": 30.0, "z": 20.0}},
        {"frame": "local", "position": {"x": 0.0, "y": 30.0, "z": 20.0}, "yaw": 0.0},
        {"latitude": LAT + 30 / 111_319.49, "longitude": LON, "altitude": 20.0},
    ):
        done = await write(pilot, "actuator/position", target, valid_for=20.0)
        assert done["status"] == "completed", done
        await eventually(
            lambda: _is(_near(vehicle.pilot.place, (30.0, 0.0))), f"it goes to {target}"
        )
        vehicle.pilot.place = (0.0, 0.0)
    far = {"position": {"x": 0.0, "y": 900.0, "z": 20.0}}
    assert (await write(pilot, "actuator/position", far, valid_for=0.5))["status"] == "completed"
    await eventually(lambda: _is(speed(vehicle) > 2.0), "it moves")
    await eventually(lambda: _is(speed(vehicle) < 0.3), "it comes to rest")
    assert vehicle.flight.mode is Mode.GUIDED
    for wrong in (
        {"altitude": 3.0},
        {"frame": "local", "latitude": 1.0, "longitude": 1.0},
        {"frame": "local", "position": {"x": 0.0, "y": 0.0}},
    ):
        assert error(await write(pilot, "actuator/position", wrong)) == "invalid_value"
    vehicle.params.set("FENCE_ENABLE", 1)
    health = pilot.served.life.backend.robots[""].vehicle

    def fenced() -> bool:
        return bool(
            health.latest["SYS_STATUS"].fields()["onboard_control_sensors_enabled"] >> 20 & 1
        )

    await eventually(lambda: _is(fenced()), "the fence is seen")
    local = {"frame": "local", "position": {"x": 0.0, "y": 900.0, "z": 20.0}}
    for out in (far, local):
        reply = await write(pilot, "actuator/position", out)
        assert error(reply) == "device_rejected", "the vehicle would ignore it silently"
    await estop(pilot)
    assert vehicle.flight.mode is Mode.BRAKE


# Sticks


async def test_sticks_steer_and_are_released(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    assert error(await write(pilot, "actuator/sticks", {"yaw": 1.0})) == "precondition_failed"
    airborne(vehicle)
    vehicle.flight.set_mode(Mode.LOITER)
    await pilot.ready()
    done = await write(pilot, "actuator/sticks", {"pitch": 0.5, "throttle": 0.25}, valid_for=1.0)
    assert done["status"] == "completed", done
    await eventually(lambda: _is(vehicle.body.vn > 1.0), "forward is forward")
    assert pytest.approx(vehicle.sticks.pitch, abs=0.01) == -0.5
    assert vehicle.sticks.throttle == pytest.approx(0.25, abs=0.01)
    await eventually(lambda: _is(not any(_deflected(vehicle))), "they are released")
    await eventually(lambda: _is(speed(vehicle) < 0.3), "it holds")
    assert vehicle.flight.mode is Mode.BRAKE
    vehicle.flight.set_mode(Mode.LOITER)
    await pilot.ready()
    channels = {"channels": [1700, None, None, 1500, None, None, None, None, 1234]}
    assert (await write(pilot, "actuator/rc", channels, valid_for=20.0))["status"] == "completed"
    await eventually(lambda: _is(vehicle.sticks.pulses[8] == 1234), "channel 9 is overridden")
    assert vehicle.sticks.roll == pytest.approx(0.5, abs=0.01)
    await estop(pilot)
    await eventually(lambda: _is(vehicle.sticks.pulses == [1500] * 16), "all are released")
    await eventually(lambda: _is(speed(vehicle) < 0.3), "it holds")


async def test_sticks_of_a_rover_drive_both_ways_and_steer() -> None:
    async with flying({"vehicle": "rover"}, sticks=True) as pilot:
        vehicle = pilot.vehicle
        vehicle.flight.set_mode(Mode.MANUAL)
        assert vehicle.arm()
        robot = pilot.served.life.backend.robots[""].vehicle
        await eventually(lambda: _is(robot.armed and robot.mode == "MANUAL"), "it is seen")
        for deflections, steering, throttle in (
            ({"yaw": 0.5}, 0.5, 0.0),
            ({"roll": -0.5, "throttle": 0.25}, -0.5, 0.25),
            ({"throttle": -0.5}, 0.0, -0.5),
        ):
            done = await write(pilot, "actuator/sticks", deflections, valid_for=20.0)
            assert done["status"] == "completed", done
            wanted = pytest.approx((steering, throttle), abs=0.01)
            await eventually(
                lambda wanted=wanted: _is((vehicle.sticks.roll, vehicle.sticks.throttle) == wanted),
                f"{deflections} arrive",
            )
        await eventually(lambda: _is(vehicle.body.speed < -1.0), "backward is backward")


async def test_a_px4_is_sent_no_overrides() -> None:
    puppet = Px4()
    async with station(puppet, sticks=True) as found:
        await px4_airborne(found, puppet)
        rc = await found.write("actuator/rc", {"channels": [1500]})
        assert error(rc) == "unknown_path", "it cannot leave out a channel"
        done = await found.write("actuator/sticks", {"pitch": 0.5}, valid_for=20.0)
        assert done["status"] == "completed", done
        await eventually(lambda: _is(bool(puppet.messages("MANUAL_CONTROL"))), "it is steered")
        assert (await found.write("actuator/sticks", {}))["status"] == "completed"
        assert puppet.messages("MANUAL_CONTROL")[0].z == 500, "centred"
        assert not puppet.messages("RC_CHANNELS_OVERRIDE")


def _deflected(vehicle: Any) -> tuple[float, ...]:
    sticks = vehicle.sticks
    return sticks.roll, sticks.pitch, sticks.throttle, sticks.yaw


async def test_without_the_setting_there_are_no_sticks() -> None:
    async with flying() as pilot:
        assert error(await write(pilot, "actuator/sticks", {"yaw": 1.0})) == "unknown_path"


# Motors


async def test_a_motor_turns_on_the_ground_and_stops(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    on_the_ground(vehicle)
    await pilot.ready()
    done = await pilot.do("action/motor_test", {"motor": 2, "throttle": 0.2})
    assert done["status"] == "completed", done
    assert done["body"] == {"motor": 2, "output": 2, "pulse": 1200}
    assert not vehicle.motor_test.motor
    none = await pilot.do("action/motor_test", {"motor": 7})
    assert error(none) == "device_rejected"
    path = "/tenant/t/action/motor_test"
    id_ = await pilot.client.send(type="execute", path=path, body={"motor": 1, "seconds": 3.0})
    await eventually(lambda: _is(vehicle.motor_test.motor == 1), "it turns")
    await pilot.client.request("cancel", path)
    assert (await pilot.client.final(id_, 30.0))["status"] == "cancelled"
    await eventually(lambda: _is(not vehicle.motor_test.motor), "it has stopped")
    armed(vehicle)
    await pilot.ready()
    refused = await pilot.do("action/motor_test", {"motor": 1})
    assert error(refused) == "precondition_failed", refused


async def test_an_estop_stops_a_motor(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    on_the_ground(vehicle)
    await pilot.ready()
    path = "/tenant/t/action/motor_test"
    id_ = await pilot.client.send(type="execute", path=path, body={"motor": 1, "seconds": 3.0})
    await eventually(lambda: _is(vehicle.motor_test.motor == 1), "it turns")
    ends_at, begin, stops = vehicle.motor_test.until, vehicle.motor_test.begin, list[float]()

    def hears_the_fifth(motor: float, kind: float, throttle: float, seconds: float) -> bool:
        stops.append(seconds)
        return len(stops) > 4 and begin(motor, kind, throttle, seconds)

    vehicle.motor_test.begin = hears_the_fifth  # type: ignore[method-assign]
    await estop(pilot)
    assert not vehicle.motor_test.motor, "rest is confirmed when it has stopped"
    assert vehicle.wall < ends_at, "the stop did it, not the time"
    assert (await pilot.client.final(id_, 30.0))["status"] != "completed"


# Payloads


async def test_payloads_do_what_they_are_told(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    assert (await pilot.do("service/servo", {"output": 9, "pulse": 1600}))["status"] == "completed"
    assert vehicle.outputs.pulses == {9: 1600}
    used = await pilot.do("service/servo", {"output": 10, "pulse": 1600})
    assert error(used) == "device_rejected"
    assert (await pilot.do("service/relay", {"relay": 2, "on": True}))["status"] == "completed"
    assert vehicle.outputs.relays == 0b10
    assert error(await pilot.do("service/relay", {"relay": 1, "on": True})) == "device_rejected"
    assert (await pilot.do("service/gripper", {"do": "grab"}))["status"] == "completed"
    assert vehicle.payloads.gripped
    assert (await pilot.do("service/gripper", {"do": "release"}))["status"] == "completed"
    assert not vehicle.payloads.gripped


async def test_a_winch_is_followed_cancelled_and_stopped(pilot: Pilot) -> None:
    vehicle, path = pilot.vehicle, "/tenant/t/action/winch"
    done = await pilot.do("action/winch", {"length": 2.0, "speed": 1.0})
    assert done["status"] == "completed", done
    assert done["body"]["length"] == pytest.approx(2.0, abs=0.1)
    assert vehicle.payloads.line == pytest.approx(2.0)
    back = await pilot.do("action/winch", {"length": -5.0, "speed": 1.0})
    assert back["body"] == {"length": 0.0}, back
    out = await pilot.do("action/winch", {"length": 90.0, "speed": 5.0})
    assert error(out) == "device_rejected", "there are only 50 m on the drum"
    await pilot.do("action/winch", {"length": -60.0, "speed": 1.0})
    for ends in (lambda: pilot.client.request("cancel", path), lambda: estop(pilot)):
        id_ = await pilot.client.send(
            type="execute", path=path, body={"length": 40.0, "speed": 0.05}
        )
        await eventually(lambda: _is(vehicle.payloads.line_speed > 0), "it winds")
        await ends()
        assert (await pilot.client.final(id_, 30.0))["status"] != "completed"
        await eventually(lambda: _is(vehicle.payloads.line_speed == 0), "it has stopped")


async def test_a_winch_that_tells_only_its_length_is_followed() -> None:
    async with flying({"parameters": {**WITH, "WINCH_TYPE": 1.0}}) as pilot:
        await pilot.ready()
        done = await pilot.do("action/winch", {"length": 4.0, "speed": 0.2})
        assert done["status"] == "completed", done
        assert pilot.vehicle.payloads.line == pytest.approx(4.0)
        assert done["body"]["length"] == pytest.approx(4.0, abs=0.02), "not the length on the way"


@pytest.fixture
def lossy(pilot: Pilot) -> list[bool]:
    """Whether the winch hears each of the next stops; then it hears all."""
    wind, heard = pilot.vehicle.payloads.wind, list[bool]()

    def sometimes(action: float, length: float, rate: float) -> bool:
        lost = action == 2 and bool(heard) and not heard.pop(0)
        return not lost and wind(action, length, rate)

    pilot.vehicle.payloads.wind = sometimes  # type: ignore[method-assign]
    return heard


async def test_the_stop_of_a_winch_is_repeated_until_it_is_seen(
    pilot: Pilot, lossy: list[bool]
) -> None:
    id_ = await _winding(pilot)
    lossy[:] = [False] * 4
    await estop(pilot)
    assert not lossy, "the last was heard"
    assert pilot.vehicle.payloads.line_speed == 0, "rest is confirmed when it has stopped"
    assert (await pilot.client.final(id_, 30.0))["status"] != "completed"


async def test_a_cancel_whose_stop_is_not_heard_is_none(pilot: Pilot, lossy: list[bool]) -> None:
    backend = pilot.served.life.backend
    id_ = await _winding(pilot)
    lossy[:] = [False] * 2
    await pilot.client.request("cancel", "/tenant/t/action/winch")
    assert (await pilot.client.final(id_, 30.0))["status"] == "failed"
    assert backend.motion(None).at_rest is False, "it winds"
    again = await pilot.do("action/winch", {"length": 1.0})
    assert error(again) == "precondition_failed"
    await eventually(lambda: _is(pilot.vehicle.payloads.line_speed == 0), "it is stopped again")
    await eventually(lambda: _is("winch" not in backend.motion(None).detail), "that is seen")


async def test_a_winch_whose_link_is_lost_is_stopped_when_it_is_back(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    robot = pilot.served.life.backend.robots[""].vehicle
    id_ = await _winding(pilot)
    vehicle.faults.uplink_cut = vehicle.faults.downlink_cut = True
    assert (await pilot.client.final(id_, 30.0))["status"] != "completed"
    assert robot.lost
    assert vehicle.payloads.line_speed > 0
    vehicle.faults.uplink_cut = vehicle.faults.downlink_cut = False
    await eventually(lambda: _is(vehicle.payloads.line_speed == 0), "it has stopped")


async def _winding(pilot: Pilot) -> str:
    """Let out line, slowly; return the id of the command."""
    body = {"length": 40.0, "speed": 0.05}
    id_ = await pilot.client.send(type="execute", path="/tenant/t/action/winch", body=body)
    await eventually(lambda: _is(pilot.vehicle.payloads.line_speed > 0), "it winds")
    return id_


async def test_a_parachute_is_guarded(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    on_the_ground(vehicle)
    await pilot.ready()
    for do in ("disable", "enable"):
        assert (await pilot.do("service/parachute", {"do": do}))["status"] == "completed"
    assert error(await pilot.do("service/parachute", {"do": "release"})) == "invalid_value"
    release = {"do": "release", "confirm": True}
    assert error(await pilot.do("service/parachute", release)) == "precondition_failed"
    airborne(vehicle, 8.0)
    await pilot.ready()
    low = await pilot.do("service/parachute", release)
    assert "Parachute: Too low" in low["message"]
    assert not vehicle.payloads.released
    vehicle.flight.aim(None, -20.0)
    skip(vehicle, lambda: vehicle.body.d < -19)
    done = await pilot.do("service/parachute", release)
    assert done["body"]["armed"] is False, done
    assert vehicle.payloads.released


def _near(a: tuple[float, float] | None, b: tuple[float, float]) -> bool:
    return a is not None and math.dist(a, b) < 0.5


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
