"""What is commanded through the gateway around a stop or a hold of a ROS 2 robot."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

import pytest

from backends.ros2.rig import (
    EXPOSE,
    MAP,
    WINDOW,
    Rig,
    confirmed,
    estop,
    gateway,
    released,
    until,
    write,
)
from backends.ros2.robot import BOUND, ignore, robot_of
from rcp_kernel.contract.fence import permitted
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, EstopActive
from timing import measured_load

pytestmark = pytest.mark.anyio


async def test_the_ros_thread_repeats_the_stop_while_the_event_loop_is_stuck(rig: Rig) -> None:
    async with gateway(rig) as robot:
        rig.commander.tell("drive", rate=20, speed=0.5)
        await rig.drives()
        robot.latched.add(None)
        await confirmed(robot)
        with measured_load() as load:
            time.sleep(WINDOW)  # noqa: ASYNC251 - that is what is tested
        rig.slips(load)


async def test_what_was_admitted_before_a_stop_is_not_sent_after_it(rig: Rig) -> None:
    async with gateway(rig) as robot:
        await estop(robot)
        began = rig.truth["began"]
        with pytest.raises(EstopActive):
            await write(robot, 0.5)
        with pytest.raises(EstopActive):
            await robot.execute("action/navigate", {"nested_field": {"int32_value": 10}})
        with pytest.raises(EstopActive):
            await robot.execute("service/dock", {"data": True})
        await write(robot, 0.0)  # rest is always allowed
        assert await rig.rests(0.5) == 0.0
        assert rig.truth["began"] == began
        robot.latched.clear()
        await released(robot)
        await write(robot, 0.5)
        await rig.drives()
        await robot.backend.halt()


class Unit:
    """What a permit is for."""

    name = "ros2"
    stops = 0


async def test_a_request_that_a_stop_has_overtaken_sends_nothing_more(rig: Rig) -> None:
    async with gateway(rig) as robot:
        unit, began = Unit(), rig.truth["began"]
        with permitted(unit, unit.stops):
            goal = robot.input("action/navigate", {"nested_field": {"int32_value": 10}})
            action = asyncio.ensure_future(robot.backend.execute("action/navigate", goal, ignore))
            wheels = asyncio.ensure_future(write(robot, 0.5))
            service = asyncio.ensure_future(robot.execute("service/dock", {"data": True}))
        unit.stops += 1  # before any of them has run
        for request in (action, wheels, service):
            with pytest.raises(EstopActive):
                await request
        assert await rig.rests(0.3) == 0.0
        assert rig.truth["began"] == began


async def test_the_safe_value_of_a_dead_man_is_sent_again_at_once(rig: Rig) -> None:
    async with gateway(rig) as robot:
        await write(robot, 0.5)
        await rig.drives()
        rig.base.tell("put", name="lossy", value=True)
        sent = time.monotonic()
        await write(robot, 0.0)
        await rig.until(lambda t: not t["told"])
        assert rig.truth["zeroed"] - sent < 1.0  # 40 ms on an idle machine; one zero alone was lost
        await rig.until(lambda t: not t["wheel"])
        await write(robot, 0.5)  # and ends with the next command
        await write(robot, 0.5)
        await write(robot, 0.5)
        await rig.drives()
        await robot.backend.halt()


async def test_an_action_that_moves_nothing_goes_on(rig: Rig) -> None:
    still = {"/action/navigate": {**MAP["/action/navigate"], "moves": False}}
    async with robot_of(rig.domain, map=MAP | still, expose=EXPOSE) as robot:
        await until(lambda: "action/navigate" in robot.resources)
        await until(lambda: robot.resources["action/navigate"].moves is False)
        assert rig.commander.tell("go", steps=20)
        await rig.until(lambda t: t["running"])
        robot.latched.add(None)
        with suppress(AdapterUnavailable, DeviceTimeout):
            await robot.backend.halt()
        finished = rig.truth["finished"]
        await rig.until(lambda t: t["finished"] > finished or not t["running"])
        assert rig.truth["finished"] > 0


async def test_hold_brings_it_to_rest_without_a_latch(rig: Rig) -> None:
    async with gateway(rig) as robot:
        assert rig.commander.tell("go", steps=400)
        await rig.until(lambda t: t["running"] and t["wheel"] > 0.3)
        await asyncio.wait_for(robot.backend.hold(None), BOUND)
        assert rig.truth["running"] == 0
        assert await rig.rests(0.5) < 0.05
        await write(robot, 0.5)  # nothing holds it
        await rig.drives()
        await robot.backend.hold(None)


async def test_the_first_command_after_a_hold_is_not_taken_for_one_of_others(rig: Rig) -> None:
    async with gateway(rig) as robot:
        rest = robot.backend.stops.keeper.rests[0]
        await until(lambda: rest.others)
        for _ in range(12):  # whether it came back before the hold had ended was a matter of chance
            await robot.backend.hold(None)
            await until(lambda: rest.counters)  # it counters the commands of others
            await write(robot, 0.5)
            await rig.drives()
        await robot.backend.hold(None)
