"""Vehicles that are broken, or two with one system id, prove nothing that is not so."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from backends.mavlink.puppet import KIND, LAT, LON, Puppet, listening, station
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import serve_backend
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed
from rcp_mavlink.commands import Command
from rcp_mavlink.duplicates import Duplicates

BRAKE, DENIED, RUNNING, PARKED = 17, 2, 5, 7_000
ROVER, COPTER, INVALID, ARDUPILOT = 10, 2, 8, 3


async def _is(truth: object) -> bool:
    return bool(truth)


def aloft() -> Puppet:
    """Make a copter that flies on, whatever it is told."""
    puppet = Puppet()
    puppet.armed, puppet.landed, puppet.mode, puppet.velocity = True, 2, 4, (5.0, 0.0, 0.0)
    puppet.results[176] = lambda _: 0
    return puppet


def parked_beside(puppet: Puppet, type_: int) -> None:
    """Have a second vehicle with the same system id, disarmed on the ground."""
    here = (round(LAT * 1e7), round(LON * 1e7))

    def tell() -> None:
        puppet.send("HEARTBEAT", type_, ARDUPILOT, 1, 0, 4, 3)
        puppet.send("GLOBAL_POSITION_INT", PARKED, *here, 400_000, 0, 0, 0, 0, 0)
        puppet.send("EXTENDED_SYS_STATE", 0, 1)

    puppet.also.append(tell)


@pytest.mark.parametrize("type_", [COPTER, ROVER])
async def test_a_parked_vehicle_with_the_same_system_id_confirms_no_stop(type_: int) -> None:
    puppet = aloft()
    async with station(puppet) as found:
        robot = found.robot
        parked_beside(puppet, type_)
        await eventually(lambda: _is(robot.vehicle.duplicated), "both are heard")
        assert robot.stop.state().at_rest is None
        assert "two vehicles use the system id 1" in robot.stop.state().detail
        with pytest.raises(PreconditionFailed, match="two vehicles"):
            robot.measurement.check()
        halt = asyncio.create_task(robot.stop.halt())
        await eventually(lambda: _is(len(puppet.commands(176)) > 3), "both are told to stop")
        assert not halt.done()
        with pytest.raises(DeviceTimeout):
            await asyncio.wait_for(halt, 20.0)


async def test_a_parked_vehicle_with_the_same_system_id_takes_no_plan_from_the_guard() -> None:
    puppet = aloft()
    async with station(puppet) as found:
        vehicle, plans = found.robot.vehicle, found.served.life.host.plans
        parked_beside(puppet, COPTER)
        await eventually(lambda: _is(vehicle.duplicated and plans), "both are heard")
        kept: list[bool] = []
        vehicle.on_frame.append(lambda _: kept.append(bool(plans)))
        await eventually(lambda: _is(len(kept) > 60), "both are heard for a while")
        assert all(kept)


async def test_a_heartbeat_of_another_kind_does_not_change_the_vehicle() -> None:
    puppet = aloft()
    async with station(puppet) as found:
        vehicle = found.robot.vehicle
        puppet.also.append(lambda: puppet.send("HEARTBEAT", ROVER, INVALID, 0, 0, 4, 3))
        await eventually(lambda: _is(vehicle.duplicated), "it is seen")
        assert vehicle.family.kind == "copter"
        assert vehicle.mode == "GUIDED"
        assert vehicle.armed


async def test_a_vehicle_with_other_firmware_is_known_after_its_restart() -> None:
    puppet = aloft()
    async with station(puppet) as found:
        vehicle = found.robot.vehicle
        puppet.type = ROVER
        await eventually(lambda: _is(vehicle.family.kind == "rover"), "it is known", 20.0)


@pytest.mark.parametrize(
    ("boots", "seen"),
    [
        ([0.0, 0.0, 0.5, 0.0], False),
        ([0.0, 90.0, 90.0, 90.2], False),  # it restarts
        ([0.0, 20.0, 0.0, 0.0], False),  # the gateway was held up for 20 s
        ([0.0, 90.0, 0.0, 90.0], True),
    ],
)
def test_two_vehicles_are_told_from_a_restart(boots: list[float], *, seen: bool) -> None:
    duplicates = Duplicates((3, 2), 100.0)
    for at, boot in enumerate(boots):
        duplicates.take_clock("ATTITUDE", boot, 100.0 + at / 4)
    assert duplicates.seen(101.0) is seen
    assert not duplicates.seen(120.0)


async def test_a_stop_reaches_both_vehicles_with_one_system_id_at_their_own_addresses() -> None:
    puppet, parked = aloft(), Puppet(type_=ROVER)
    async with listening(puppet) as one, listening(parked) as other:
        links = [f"udpout:127.0.0.1:{port}" for port in (one, other)]
        async with serve_backend(KIND, {"links": links, "timeout": 0.3, "silence": 1.5}) as served:
            robots = await opened(served)
            await eventually(lambda: _is(robots[""].vehicle.duplicated), "both are heard")
            puppet.write = lambda _: None  # type: ignore[method-assign]  # it still receives
            alone = asyncio.get_running_loop().time()
            seen = robots[""].vehicle.received_at
            await eventually(lambda: _is(seen["EXTENDED_SYS_STATE"] > alone + 0.2), "one is heard")
            halt = asyncio.create_task(robots[""].stop.halt())
            await eventually(lambda: _is(puppet.commands(176)), "it is told to stop", 8.0)
            await eventually(lambda: _is(parked.commands(176)), "the other is told to stop", 8.0)
            halt.cancel()
            await asyncio.wait((halt,))


async def opened(served: Any) -> Any:
    await eventually(lambda: _is(served.lives and served.life.backend.robots), "it is open", 20.0)
    return served.life.backend.robots


def test_a_vehicle_that_falls_silent_is_not_succeeded_by_the_one_beside_it() -> None:
    duplicates, own, other = Duplicates((3, 2), 100.0), (3, 2), (3, 10)
    for beat in range(5):
        assert duplicates.is_own(own, 101.0 + beat)
        assert not duplicates.is_own(other, 101.5 + beat)
    for beat in range(60):
        assert not duplicates.is_own(other, 106.5 + beat)
        assert duplicates.seen(106.5 + beat)
    assert duplicates.is_own(own, 170.0)


def test_a_vehicle_with_other_firmware_succeeds_although_one_heartbeat_overtook_another() -> None:
    duplicates, own, new = Duplicates((3, 2), 100.0), (3, 2), (12, 2)
    assert not duplicates.is_own(new, 101.0)
    assert duplicates.is_own(own, 101.1)
    assert not duplicates.is_own(new, 102.0)
    assert duplicates.is_own(new, 105.0)


@pytest.mark.parametrize("silent", [False, True])
async def test_a_stop_holds_after_a_restart_in_the_air(*, silent: bool) -> None:
    puppet = aloft()

    def set_mode(message: Any) -> int:
        puppet.mode, puppet.velocity = int(message.param2), (0.0, 0.0, 0.0)
        return 0

    puppet.results[176] = set_mode
    async with station(puppet) as found:
        stop = await found.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stop["status"] == "completed", stop
        if silent:
            puppet.quiet = True
            await eventually(lambda: _is(found.robot.vehicle.lost), "it is lost")
            puppet.quiet = False
        puppet.booted = asyncio.get_running_loop().time()  # as after its watchdog
        puppet.mode, puppet.velocity = 0, (3.0, 0.0, 0.0)
        await eventually(lambda: _is(puppet.mode == BRAKE), "it is stopped again")


async def test_a_hold_does_not_trust_what_was_said_of_the_ground_before() -> None:
    puppet = aloft()
    puppet.landed = 1
    async with station(puppet) as found:
        robot = found.robot
        await eventually(lambda: _is(robot.vehicle.landed), "it stands")
        send = puppet.send

        def without_landed(name: str, *fields: Any) -> None:  # its message is lost from now on
            if name != "EXTENDED_SYS_STATE":
                send(name, *fields)

        puppet.send = without_landed  # type: ignore[method-assign]
        measurement = robot.measurement
        await eventually(lambda: _is(not measurement.standing), "it is too old")
        puppet.results[176] = lambda m: setattr(puppet, "mode", int(m.param2)) or 0
        await robot.motion.hold()
        assert puppet.mode == BRAKE


async def test_a_pause_is_not_confirmed_by_a_position_of_before() -> None:
    puppet, paused = aloft(), 4
    puppet.mode, puppet.velocity = 3, (0.0, 0.0, 0.0)
    puppet.results[193] = lambda _: 0
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.mode == "AUTO"), "it flies its mission")
        await eventually(lambda: _is(found.robot.measurement.speed == 0.0), "it stands still")
        send = puppet.send

        def without_position(name: str, *fields: Any) -> None:  # its messages are lost from now on
            if name != "GLOBAL_POSITION_INT":
                send(name, *fields)

        puppet.send = without_position  # type: ignore[method-assign]
        await eventually(lambda: _is(found.robot.measurement.stale()), "it is too old")
        puppet.also.append(lambda: send("MISSION_CURRENT", 1, 2, paused, 1))
        asked = asyncio.create_task(found.do("action/mission/pause"))
        await eventually(lambda: _is(puppet.commands(193)), "it is told to pause")
        told = asyncio.get_running_loop().time()
        seen = found.robot.vehicle.received_at
        await eventually(
            lambda: _is(seen.get("MISSION_CURRENT", told) > told + 0.5), "it has said so"
        )
        assert not asked.done()
        puppet.send = send  # type: ignore[method-assign]
        assert (await asked)["status"] == "completed"


async def test_the_answer_to_a_repetition_is_not_that_of_the_next_command() -> None:
    async with station(Puppet()) as found:
        puppet, later = found.puppet, asyncio.get_running_loop().call_later
        results = iter([0, 0, DENIED, DENIED, DENIED])

        def answer(message: Any) -> None:  # later than it is waited for
            if message.command == 211:
                later(0.4, puppet.send, "COMMAND_ACK", 211, next(results), 0, 0, 255, 190)

        puppet.on["COMMAND_LONG"] = answer
        first = await found.do("service/command", {"command": "DO_GRIPPER"})
        assert first["status"] == "completed", first
        second = await found.do("service/command", {"command": "DO_GRIPPER"})
        assert second["status"] == "rejected", second


def owe(commands: Any, number: int) -> None:
    """Have a reply to an earlier command of a number still to come."""
    commands._orphans[number] = (1, time.monotonic() + 60.0)  # noqa: SLF001


def has_turn(commands: Any, number: int) -> bool:
    """Return whether a command of a number is being sent."""
    return commands._turns[number].locked()  # noqa: SLF001


async def test_a_hold_is_sent_at_once_while_replies_to_an_earlier_mode_may_still_come() -> None:
    puppet = aloft()
    puppet.results[176] = lambda m: setattr(puppet, "mode", int(m.param2)) or 0
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "it flies")
        commands = found.robot.motion._commands  # noqa: SLF001
        owe(commands, 176)
        holding = asyncio.create_task(found.robot.motion.hold())
        await eventually(lambda: _is(puppet.mode == BRAKE), "it is told", 10.0)
        puppet.send("COMMAND_ACK", 176, DENIED, 0, 0, 255, 190)  # the late one
        await asyncio.wait_for(holding, 20.0)


async def test_a_late_reply_is_still_known_as_such_after_a_cancellation() -> None:
    async with station(Puppet()) as found:
        puppet = found.puppet
        commands = found.robot.motion._commands  # noqa: SLF001
        puppet.results[211] = lambda _: DENIED
        owe(commands, 211)
        gripper = Command(211)
        cancelled = asyncio.create_task(commands.send(gripper, "gripper"))
        await eventually(lambda: _is(has_turn(commands, 211)), "it waits")
        cancelled.cancel()
        await asyncio.wait((cancelled,))
        again = asyncio.create_task(commands.send(gripper, "gripper"))
        await eventually(lambda: _is(has_turn(commands, 211)), "it waits")
        for result in (RUNNING, 0):  # of a command before, which goes on for a while
            puppet.send("COMMAND_ACK", 211, result, 0, 0, 255, 190)
        with pytest.raises(DeviceRejected):
            await asyncio.wait_for(again, 20.0)


async def test_a_list_whose_length_changes_meanwhile_is_complete_with_all_of_it() -> None:
    puppet = Puppet()
    puppet.params = {f"P{n}": (float(n), 9) for n in range(9)}

    def listed(_: Any) -> None:
        for name in list(puppet.params)[:4]:
            puppet.tell(name)
        for n in range(5, 9):  # what came before the change is not where it was
            puppet.params.pop(f"P{n}", None)
        puppet.params = {"NEW": (1.0, 9), **puppet.params}
        for name in list(puppet.params)[4:]:
            puppet.tell(name)

    puppet.on["PARAM_REQUEST_LIST"] = listed
    puppet.on["PARAM_REQUEST_READ"] = lambda m: puppet.tell([*puppet.params][m.param_index])
    async with station(puppet) as found:
        parameters = found.robot.parameters
        await asyncio.wait_for(parameters.complete.wait(), 20.0)
        assert set(parameters.known) == set(puppet.params)
