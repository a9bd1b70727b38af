"""By what a ROS 2 robot is stopped, what shows that it was, and what ends when it was lost."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from backends.ros2.rig import MAP, Rig, confirmed, estop, gateway, released, until, write
from backends.ros2.robot import BOUND, ignore
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout, EstopActive
from timing import measured_load

pytestmark = pytest.mark.anyio
MEANS: dict[str, dict[str, Any]] = {
    "service": {
        "service": {
            "name": "/estop",
            "type": "std_srvs/srv/SetBool",
            "request": {"data": True},
            "released": {"data": False},
        }
    },
    "e_stop": {"topic": {"name": "/e_stop"}},
    "lock": {"twist_mux_lock": "/lock"},
}


@pytest.mark.parametrize("means", MEANS)
async def test_a_configured_means_stops_it_outright_until_the_reset(rig: Rig, means: str) -> None:
    async with gateway(rig, stop=MEANS[means]) as robot:
        rig.commander.tell("drive", rate=50, speed=0.5)
        await rig.drives()
        robot.latched.add(None)
        await confirmed(robot)
        assert rig.truth["brakes"] == [means]
        assert await rig.rests() == 0.0
        robot.latched.clear()
        await rig.until(lambda t: not t["brakes"])
        await rig.drives()


async def test_a_stop_service_that_fails_is_told_and_the_wheels_decide(rig: Rig) -> None:
    rig.base.tell("put", name="works", value=False)
    async with gateway(rig, stop=MEANS["service"]) as robot:
        await write(robot, 0.5)
        await rig.drives()
        await estop(robot)
        assert "the relay is stuck" in robot.backend.motion(None).detail
        assert await rig.rests(0.5) == 0.0
    async with gateway(rig, stop={**MEANS["service"], "feedback": False}) as robot:
        with pytest.raises(DeviceRejected, match="the relay is stuck"):
            await estop(robot)


async def test_without_feedback_a_contested_stop_is_not_confirmed(rig: Rig) -> None:
    async with gateway(rig, stop={"feedback": False}) as robot:
        await estop(robot)
        assert robot.backend.motion(None).at_rest  # delivered, and nobody contests it
        rig.commander.tell("drive", rate=20, speed=0.5)
        await until(lambda: not robot.backend.motion(None).at_rest)
        with pytest.raises(AdapterUnavailable, match="/teleop"):
            await asyncio.wait_for(robot.backend.halt(), BOUND)
        await rig.counters()


async def test_without_feedback_a_frozen_robot_is_not_confirmed(rig: Rig) -> None:
    async with gateway(rig, stop={"feedback": False}) as robot:
        await asyncio.wait_for(robot.backend.halt(), BOUND)
        await released(robot)
        rig.base.freeze()
        try:
            with pytest.raises(AdapterUnavailable, match="does not respond"):
                await estop(robot)
        finally:
            rig.base.thaw()
        await confirmed(robot)


async def test_feedback_that_is_demanded_and_absent_confirms_nothing(rig: Rig) -> None:
    async with gateway(rig, stop={"feedback": "/nowhere"}) as robot:
        with pytest.raises(AdapterUnavailable, match="no feedback on /nowhere yet"):
            await estop(robot)


async def test_motion_without_its_feedback_is_refused_and_what_runs_is_stopped(rig: Rig) -> None:
    fed = {
        name: {**mapping, "feedback": "/odom"} if "service" not in mapping else mapping
        for name, mapping in MAP.items()
    }
    async with gateway(rig, map=fed, grace=0.5) as robot:
        goal = robot.input("action/navigate", {"nested_field": {"int32_value": 400}})
        running = asyncio.ensure_future(robot.backend.execute("action/navigate", goal, ignore))
        await rig.until(lambda t: t["running"])
        rig.base.tell("put", name="frozen", value=True)
        with pytest.raises(DeviceTimeout, match="no feedback on /odom"):
            await asyncio.wait_for(running, BOUND)
        await rig.until(lambda t: not t["running"])
        with pytest.raises(AdapterUnavailable, match="no feedback on /odom"):
            await write(robot, 0.5)
        with pytest.raises(AdapterUnavailable, match="no feedback on /odom"):
            await robot.execute("action/navigate", {"nested_field": {"int32_value": 1}})
        rig.base.tell("put", name="frozen", value=False)
        (odometry,) = robot.backend.stops.feedbacks.of(None)
        await until(odometry.is_fresh)
        await write(robot, 0.5)
        await rig.drives()
        with measured_load() as load:
            began = time.monotonic()
            rig.base.tell("put", name="frozen", value=True)
            await rig.until(lambda t: t["wheel"] == 0.0)
            took = time.monotonic() - began
        assert took < load.allows(10.0, 5.0)


async def test_a_goal_that_was_given_up_does_not_go_on_when_its_server_is_back(rig: Rig) -> None:
    async with gateway(rig, silence=1.0) as robot:
        goal = robot.input("action/navigate", {"nested_field": {"int32_value": 600}})
        running = asyncio.ensure_future(robot.backend.execute("action/navigate", goal, ignore))
        await rig.until(lambda t: t["running"] and t["wheel"] > 0.3)
        finished = rig.truth["finished"]
        await asyncio.sleep(0.6)  # until the first look after the server is past
        rig.base.freeze()
        try:
            with pytest.raises((AdapterUnavailable, DeviceTimeout)):
                await asyncio.wait_for(running, BOUND)
        finally:
            rig.base.thaw()
        await rig.until(lambda t: not t["running"])
        assert rig.truth["finished"] == finished  # it was cancelled, and did not run out
        assert "held" in await robot.backend.recover(None)


async def test_what_an_earlier_gateway_began_is_ended_when_it_was_lost(rig: Rig) -> None:
    finished = rig.truth["finished"]
    assert rig.commander.tell("go", steps=400)  # the earlier gateway's, as far as can be known
    await rig.until(lambda t: t["running"])
    async with gateway(rig) as robot:
        assert "all goals cancelled" in await robot.backend.recover(None)
        await rig.until(lambda t: not t["running"])
        assert rig.truth["finished"] == finished  # it was cancelled, and did not run out
    assert rig.commander.tell("go", steps=400)
    await rig.until(lambda t: t["running"])
    async with gateway(rig, on_loss="continue") as robot:
        assert await robot.backend.recover(None) == "continued"
        assert rig.truth["running"] == 1
        await robot.backend.halt()


async def test_the_guard_is_told_what_stops_the_robot(rig: Rig) -> None:
    async with gateway(rig, stop=MEANS["service"] | MEANS["lock"]) as robot:
        await robot.until(
            lambda: (
                (plan := robot.plans.get("ros2")) and plan.data["services"] and plan.data["cancel"]
            )
        )
        plan = robot.plans["ros2"]
        assert plan.sender == "ros2"
        assert plan.data["domain_id"] == rig.domain
        (publisher,) = plan.data["publishers"]
        assert (publisher["topic"], publisher["type"]) == ("/cmd_vel", "geometry_msgs/msg/Twist")
        assert bytes.fromhex(publisher["data"])[4:] == bytes(48)  # six zeros
        assert publisher["reliable"]
        assert plan.data["cancel"] == ["/navigate"]
        (service,) = plan.data["services"]
        assert (service["name"], service["type"]) == ("/estop", "std_srvs/srv/SetBool")
        assert bytes.fromhex(service["data"])[4] == 1
        (watchdog,) = robot.backend.watchdogs()
        assert watchdog.within is None
        assert not watchdog.verified
        await estop(robot)
        await robot.until(lambda: len(robot.plans["ros2"].data["publishers"]) == 2)  # the lock


async def test_services_move_unless_their_type_only_tells_or_the_map_says_so(rig: Rig) -> None:
    services: dict[str, Any] = {
        "/service/still": {"service": "/dock", "type": "std_srvs/srv/SetBool", "moves": False},
        "/service/power": {
            "service": "/estop",
            "type": "std_srvs/srv/SetBool",
            "moves": False,
            "energises": True,
        },
        "/service/tells": {"service": "/plan", "type": "nav_msgs/srv/GetPlan"},
    }
    async with gateway(rig, map=MAP | services) as robot:
        await robot.until(lambda: {"service/tells", "service/dock"} <= robot.resources.keys())
        moves = {name.removeprefix("service/"): r.moves for name, r in robot.resources.items()}
        assert (moves["dock"], moves["still"], moves["tells"]) == (True, False, False)
        assert robot.resources["service/power"].energises
        await estop(robot)
        with pytest.raises(EstopActive):
            await robot.execute("service/power", {"data": True})
        await robot.execute("service/still", {"data": False})
