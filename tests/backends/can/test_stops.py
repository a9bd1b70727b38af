"""A stop holds, and a halt says what became of it: the twin's plant is the witness."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from typing import Any

import anyio
import pytest

from backends.can.rig import MOTORS, Node, motor, opened
from backends.can.stopping import stays_at_rest, turns
from backends.can.test_joints import arm
from rcp_kernel.contract.fence import permitted
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceTimeout,
    EstopActive,
    RcpError,
)

every_profile = pytest.mark.parametrize("profile", MOTORS)


async def test_a_quick_stopped_drive_is_said_to_hold_torque() -> None:
    async with motor("cia402") as rig:
        await turns(rig)
        await rig.backend.halt()
        assert rig.twin.state == "quick_stop"
        state = await rig.host.published_as("sensor/m/state", state="quick_stop")
        assert state.energised is True
        motion = rig.backend.motion(None)
        assert (motion.at_rest, motion.energised) == (True, True)


@pytest.mark.parametrize("option", [2, 6])
async def test_what_follows_a_quick_stop_is_what_is_configured(option: int) -> None:
    async with motor("cia402", options={"quick_stop": option}) as rig:
        await turns(rig)
        await rig.backend.halt()
        await rig.host.published_as("sensor/m/state", energised=option == 6)
        assert rig.twin.state == ("quick_stop" if option == 6 else "switch_on_disabled")


@every_profile
async def test_a_motor_that_is_silent_is_no_confirmed_stop_and_is_stopped_when_it_is_back(
    profile: str,
) -> None:
    async with motor(profile) as rig:
        await turns(rig)
        rig.twin.silent = True
        with pytest.raises(RcpError) as caught:
            await rig.backend.halt()
        assert isinstance(caught.value, AdapterUnavailable | DeviceTimeout)
        rig.host.latched = True
        rig.host.on_restored = lambda: rig.backend.hold_stop(None)
        await rig.host.published_as("sensor/m/state", state="offline")
        with pytest.raises(AdapterUnavailable):
            await rig.backend.halt()
        assert rig.backend.motion(None).at_rest is None
        rig.twin.silent = False
        await rig.until(lambda: rig.host.restored)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        await rig.until(lambda: rig.axis.configured)
        await rig.backend.halt()


@pytest.mark.parametrize("optional", [False, True])
async def test_a_motor_that_was_never_heard_is_named_and_the_others_are_stopped(
    optional: bool,  # noqa: FBT001
) -> None:
    absent = {"bus": "can0", "profile": "odrive", "node": 9, "optional": optional}
    patient = {"timeout": 10.0, "feedback_timeout": 10.0}  # two gateways and a busy machine
    async with motor("odrive", **patient) as sole:
        table = {"bus": "can0", "profile": "odrive", "node": 1, **patient}
        bus = {"interface": "virtual", "channel": sole.channel}
        motors = {"m": table, "gripper": absent}
        async with opened({"buses": {"can0": bus}, "motors": motors, "grace": 0.2}) as rig:
            await sole.until(lambda: rig.backend.axes["m"].configured)
            await rig.ran("service/m/enable")
            await rig.write("actuator/m/velocity", 2.0)
            await sole.until(lambda: sole.twin.plant.velocity > 1.0)
            if optional:
                await rig.backend.halt()
                assert rig.backend.motion(None).at_rest is True
            else:
                with pytest.raises(AdapterUnavailable, match="gripper"):
                    await rig.backend.halt()
                assert rig.backend.motion(None).at_rest is None
            assert abs(sole.twin.plant.velocity) < 0.1


async def test_reports_from_before_a_stop_do_not_confirm_it_however_late_they_are_read() -> None:
    async with motor("odrive", timeout=9.0, feedback_timeout=9.0) as rig:
        await rig.enable()
        await rig.ordered(lambda: setattr(rig.twin, "blind", True))
        seen = rig.axis.status.counts["velocity"]
        with Node(rig.channel) as node, rig.unread():
            await rig.ordered(lambda: None)  # the reader waits
            for _ in range(5):
                node.send(1 << 5 | 0x09, struct.pack("<ff", 0.0, 0.0))
            sent = time.monotonic()
            await rig.until(lambda: time.monotonic() - sent > 0.05)
            halting = asyncio.ensure_future(rig.backend.halt())
            await rig.until(lambda: rig.axis.stopping)
        await rig.until(lambda: rig.axis.status.counts["velocity"] >= seen + 5)
        done, _ = await asyncio.wait((halting,), timeout=0.2)
        assert not done
        await rig.ordered(lambda: setattr(rig.twin, "blind", False))
        await halting


async def test_the_torque_goes_some_time_after_a_stop_where_that_is_configured() -> None:
    for profile in ("cia402", "odrive", "damiao", "moteus"):
        async with motor(profile, torque_off_after=0.3) as rig:
            await turns(rig)
            await rig.backend.halt()
            assert rig.host.last("sensor/m/state").energised
            await rig.host.published_as("sensor/m/state", energised=False, state="disabled")
            await rig.until(lambda r=rig: not r.twin.enabled and r.twin.plant.loop == "off")
            await stays_at_rest(rig, 0.2)
            rig.backend.hold_stop(None)
            await asyncio.sleep(0.1)
            assert rig.twin.plant.loop == "off"
            await rig.enable()


@pytest.mark.parametrize("profile", ["vesc", "odrive", "cia402"])
@pytest.mark.usefixtures("stands_still")
async def test_a_gateway_that_stood_still_sends_no_set_point_of_before(profile: str) -> None:
    slow = {"timeout": 3.0, "feedback_timeout": 3.0, "watchdog": 0.5}
    async with motor(profile, valid_for=60.0, **slow) as rig:
        await turns(rig)
        taken = len(rig.twin.commands)
        time.sleep(0.8)  # noqa: ASYNC251  # the loop is what stands still
        # the one of CANopen has left operational meanwhile: its watchdog has expired
        await rig.host.until(lambda: {"gateway_stalled", "reset"} & set(rig.faults()))
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        assert all(abs(value) < 0.05 for _, value in rig.twin.commands[taken:][3:])


# The fence


class Unit:
    name, stops = "/tenant/alpha", 0


@pytest.mark.parametrize("cancel", ["before", "with", "after"])
async def test_no_set_point_of_a_cancelled_trajectory_follows_the_halt(cancel: str) -> None:
    async with arm() as rig:
        unit = Unit()

        async def move() -> Any:
            with permitted(unit, 0):
                return await rig.execute(
                    "action/arm/move_joints", {"positions": {"pan": 5.0, "tilt": 5.0, "roll": 5.0}}
                )

        moving = asyncio.ensure_future(move())
        await rig.until(lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()))
        unit.stops += 1
        if cancel == "before":
            moving.cancel()
            await asyncio.sleep(0)
        halting = asyncio.ensure_future(rig.backend.halt())
        await asyncio.sleep(0)
        if cancel == "with":
            moving.cancel()
        with anyio.fail_after(60):
            await halting
        assert rig.still()
        if cancel == "after":
            moving.cancel()
        await asyncio.wait((moving,), timeout=60)
        stood = {name: twin.plant.position for name, twin in rig.twins.items()}
        taken = {name: len(twin.commands) for name, twin in rig.twins.items()}
        for _ in range(60):
            assert rig.still()
            await asyncio.sleep(0.005)
        for name, twin in rig.twins.items():
            assert twin.plant.position == pytest.approx(stood[name], abs=0.02)
            assert all(abs(value) < 0.05 for _, value in twin.commands[taken[name] :])


@every_profile
async def test_what_a_stop_has_cut_off_can_send_nothing_that_moves(profile: str) -> None:
    async with motor(profile) as rig:
        unit = Unit()
        unit.stops = 1
        await rig.enable()
        calls: list[Callable[[], Any]] = [
            lambda: rig.write("actuator/m/velocity", 1.0),
            lambda: rig.execute("service/m/enable"),
        ]
        for call in calls:
            with permitted(unit, 0), pytest.raises(EstopActive):
                await call()
        with permitted(unit, 0):
            rig.axis.stop()  # a stop passes, whoever sends it
            await rig.execute("service/m/disable")
        await rig.until(lambda: not rig.twin.enabled)
