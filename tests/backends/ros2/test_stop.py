"""A stop of a ROS 2 robot that holds: its wheels rest, whoever else commands them.

The wheels are looked at in their own process, past every interface of ROS."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.ros2.rig import (
    CREEP,
    EXPOSE,
    MAP,
    Rig,
    confirmed,
    estop,
    gateway,
    until,
    write,
)
from backends.ros2.robot import BOUND, fresh_domain, robot_of
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("rate", [20, 50])
async def test_a_publisher_that_goes_on_is_outspoken_and_named(rig: Rig, rate: int) -> None:
    async with gateway(rig) as robot:
        rig.commander.tell("drive", rate=rate, speed=0.5)
        await rig.drives()
        robot.latched.add(None)
        await confirmed(robot)  # the gateway itself has sent nothing before
        await rig.counters()
        state = robot.backend.motion(None)
        assert "/teleop" in state.detail
        assert "publishes on /cmd_vel at" in state.detail
        await robot.until(lambda: any("/teleop" in (report or "") for report in robot.reports))
        robot.latched.clear()  # and after the reset the other one is obeyed again
        await rig.drives()


async def test_a_robot_that_obeys_the_last_command_for_ever_is_stopped_without_one_of_ours(
    rig: Rig,
) -> None:
    async with gateway(rig) as robot:
        rig.commander.tell("say", speed=0.5)
        await rig.drives()
        await estop(robot)
        assert await rig.rests() == 0.0
        assert robot.backend.motion(None).at_rest


async def test_the_halt_returns_when_the_wheels_rest_and_not_before(rig: Rig) -> None:
    async with gateway(rig) as robot:
        await write(robot, 0.5)
        await rig.drives()
        assert robot.backend.motion(None).at_rest is False
        took = await estop(robot)
        assert abs(rig.truth["wheel"]) <= 0.05
        assert took > 0.15  # what the wheels take


async def test_goals_of_others_are_cancelled_also_those_that_come_under_the_latch(
    rig: Rig,
) -> None:
    async with gateway(rig) as robot:
        assert rig.commander.tell("go", steps=400)
        await rig.until(lambda t: t["running"] and t["wheel"] > 0.3)
        finished = rig.truth["finished"]
        await estop(robot)
        assert rig.truth["running"] == 0
        assert await rig.rests() < CREEP
        began = rig.truth["began"]
        assert rig.commander.tell("go", steps=400)
        await rig.until(lambda t: t["began"] > began)
        await rig.until(lambda t: not t["running"])
        assert await rig.rests() < CREEP
        assert rig.truth["finished"] == finished


async def test_a_server_that_is_killed_and_comes_back_gets_the_stop_before_anything_else() -> None:
    rig = Rig()
    rig.start()
    try:
        async with gateway(rig) as robot:
            rig.commander.tell("drive", rate=20, speed=0.5)
            await rig.drives()
            robot.latched.add(None)
            await confirmed(robot)
            rig.base.kill()
            with pytest.raises((AdapterUnavailable, DeviceTimeout)):
                await asyncio.wait_for(robot.backend.halt(), BOUND)
            assert robot.backend.motion(None).at_rest is None
            robot.restored.clear()
            rig.base.start()
            await robot.until(lambda: robot.restored)
            assert rig.commander.tell("go", steps=400)
            # It may be cancelled before it has begun.
            await rig.until(lambda t: not t["running"])
            await confirmed(robot)
            await rig.counters()
    finally:
        rig.stop()


async def test_two_of_three_stop_messages_may_be_lost(rig: Rig) -> None:
    async with gateway(rig) as robot:
        await write(robot, 0.5)
        await rig.drives()
        rig.base.tell("put", name="lossy", value=True)
        took = await estop(robot)
        assert took < 4.0
        assert await rig.rests() == 0.0


async def test_a_frozen_robot_is_not_confirmed_and_rests_when_it_goes_on(rig: Rig) -> None:
    async with gateway(rig) as robot:
        await write(robot, 0.5)
        await rig.drives()
        rig.base.freeze()
        try:
            with pytest.raises(AdapterUnavailable, match="no feedback on /odom"):
                await estop(robot)
            assert robot.backend.motion(None).at_rest is None
            robot.restored.clear()
        finally:
            rig.base.thaw()
        await robot.until(lambda: robot.restored)
        await confirmed(robot)
        assert await rig.rests() == 0.0


@pytest.mark.parametrize("frozen", [False, True])
async def test_rest_from_before_the_motion_that_arrives_after_the_stop_confirms_nothing(
    rig: Rig, *, frozen: bool
) -> None:
    async with gateway(rig) as robot:
        (odometry,) = robot.backend.stops.feedbacks.of(None)
        rig.base.tell("put", name="delay", value=2.0)
        await until(lambda: not odometry.is_fresh())
        await until(odometry.is_fresh)
        rig.base.tell("put", name="grip", value=0.4)
        await write(robot, 0.5)
        await rig.drives()
        assert odometry.state().at_rest, "the motion was seen already"
        if frozen:
            rig.base.freeze()
            await until(lambda: (odometry.age() or 0.0) > 0.2)
            rig.base.thaw()
        await confirmed(robot)
        assert rig.truth["wheel"] < 0.05


async def test_odometry_that_repeats_its_last_measurement_measures_nothing(rig: Rig) -> None:
    async with gateway(rig) as robot:
        rig.base.tell("put", name="frozen", value=True)
        with pytest.raises(AdapterUnavailable, match="no feedback on /odom"):
            await estop(robot)
        rig.base.tell("put", name="frozen", value=False)
        await confirmed(robot)


async def test_a_robot_that_is_not_there_is_not_known_to_be_at_rest() -> None:
    config: dict[str, Any] = {"map": {"/action/navigate": MAP["/action/navigate"]}}
    async with robot_of(fresh_domain(), **config, grace=0.5) as robot:
        with pytest.raises(AdapterUnavailable, match="no node offers /navigate"):
            await estop(robot)
    async with robot_of(fresh_domain(), expose=["/**"], grace=0.5) as robot:
        with pytest.raises(AdapterUnavailable, match="no node of the robot is running"):
            await estop(robot)
    async with robot_of(fresh_domain(), map=MAP) as robot:  # a zero goes out when it is heard
        robot.latched.add(None)
        with pytest.raises(AdapterUnavailable, match="no node subscribes to /cmd_vel"):
            await robot.backend.halt()


async def test_a_robot_that_comes_under_a_latch_is_stopped_as_soon_as_it_is_there() -> None:
    rig = Rig()
    rig.commander.start()
    try:
        async with robot_of(rig.domain, map=MAP, expose=EXPOSE) as robot:
            robot.latched.add(None)
            with pytest.raises(AdapterUnavailable):
                await robot.backend.halt()
            rig.base.start()
            await rig.until(lambda t: t["heard"] > 0)
            rig.commander.tell("drive", rate=20, speed=0.5)
            await confirmed(robot)
            await rig.counters()
    finally:
        rig.stop()
