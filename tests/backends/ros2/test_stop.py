"""A stop of a ROS 2 robot that holds: its wheels rest, whoever else commands them.

The wheels are looked at in their own process, past every interface of ROS.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest

from backends.ros2.robot import BOUND, Base, Commander, Robot, fresh_domain, ignore, robot_of
from failures import failed
from rcp_kernel.contract.fence import permitted
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout, EstopActive

pytestmark = pytest.mark.anyio

VELOCITY = "actuator/velocity"
MAP: dict[str, Any] = {
    "/actuator/velocity": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
    "/action/navigate": {"action": "/navigate", "type": "test_msgs/action/NestedMessage"},
    "/service/dock": {"service": "/dock", "type": "std_srvs/srv/SetBool"},
}
EXPOSE = ["/odom"]
CREEP = 0.1  # m/s that a command which slips in between two zeros may give the wheels
SLIP = 0.4  # m/s: the same, where the machine is so busy that a zero comes late
WINDOW = 1.5  # s for which they are looked at


async def until(holds: Callable[[], Any], seconds: float = BOUND) -> None:
    """Wait until something holds that nothing tells of."""
    async with asyncio.timeout(seconds):
        while not holds():  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.02)


def _parties() -> tuple[int, Base, Commander]:
    domain = fresh_domain()
    return domain, Base(domain), Commander(domain)


class Rig:
    """The base, the commander, and the domain they share."""

    def __init__(self) -> None:
        self.domain, self.base, self.commander = _parties()

    def start(self) -> None:
        self.base.start()
        self.commander.start()

    def stop(self) -> None:
        self.commander.stop()
        self.base.stop()

    def renew(self) -> None:
        self.commander.tell("rest")
        self.base.tell("renew")

    def replace(self) -> None:
        """Begin again elsewhere: what one test left wrong fails no other."""
        self.stop()
        self.domain, self.base, self.commander = _parties()
        self.start()

    @property
    def truth(self) -> dict[str, Any]:
        return self.base.tell("truth")

    async def until(self, holds: Callable[[dict[str, Any]], Any], seconds: float = BOUND) -> None:
        """Wait until something holds of the truth."""
        await until(lambda: holds(self.truth), seconds)

    async def drives(self) -> None:
        await self.until(lambda t: t["wheel"] > 0.3)

    async def rests(self, window: float = WINDOW) -> float:
        """Return the most that the wheels turned in a while from now."""
        await asyncio.sleep(window)  # in which nothing may move
        return self.base.tell("peak", seconds=window)


@pytest.fixture(scope="module")
def module_rig() -> Iterator[Rig]:
    rig = Rig()
    rig.start()
    yield rig
    rig.stop()


@pytest.fixture
def rig(module_rig: Rig, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The base at rest, with nobody commanding it."""
    yield module_rig
    if failed(request.node):
        module_rig.replace()
    else:
        module_rig.renew()


@asynccontextmanager
async def gateway(rig: Rig, **config: Any) -> AsyncIterator[Robot]:
    """Open a backend that knows all of the base."""
    given: dict[str, Any] = {"map": MAP, "expose": EXPOSE, **config}
    async with robot_of(rig.domain, **given) as robot:
        await known(robot)
        yield robot


async def known(robot: Robot) -> None:
    """Return once the base and what it offers is discovered."""
    stops = robot.backend.stops
    keeper = stops.keeper
    await until(lambda: "/navigate" in keeper.servers and keeper.rests)
    await until(lambda: keeper.rests[0].outlet.count() and keeper.rests[0].outlet.nodes)
    await until(lambda: MAP.keys() <= {f"/{name}" for name in robot.resources})
    if robot.backend.catalog.shared.config.stop.feedback is True:
        await until(lambda: any(one.is_fresh() for one in stops.feedbacks.of(None)))


async def estop(robot: Robot) -> float:
    """Latch and halt as the kernel does; return how long the halt took."""
    robot.latched.add(None)
    began = time.monotonic()
    await asyncio.wait_for(robot.backend.halt(), BOUND)
    return time.monotonic() - began


async def confirmed(robot: Robot) -> None:
    """Halt again until it is confirmed, as the kernel does."""
    async with asyncio.timeout(BOUND):
        while True:
            with suppress(AdapterUnavailable, DeviceTimeout):
                return await robot.backend.halt()


async def write(robot: Robot, speed: float) -> None:
    await robot.backend.write(VELOCITY, robot.input(VELOCITY, {"linear": {"x": speed}}))


@pytest.mark.parametrize("rate", [20, 50])
async def test_a_publisher_that_goes_on_is_outspoken_and_named(rig: Rig, rate: int) -> None:
    async with gateway(rig) as robot:
        rig.commander.tell("drive", rate=rate, speed=0.5)
        await rig.drives()
        robot.latched.add(None)
        await confirmed(robot)  # the gateway itself has sent nothing before
        assert await rig.rests() < SLIP
        assert rig.base.tell("mean", seconds=WINDOW) < CREEP / 2
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
        await rig.until(lambda t: not t["running"], 10.0)
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
            assert await rig.rests() < SLIP
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


async def test_the_ros_thread_repeats_the_stop_while_the_event_loop_is_stuck(rig: Rig) -> None:
    async with gateway(rig) as robot:
        rig.commander.tell("drive", rate=20, speed=0.5)
        await rig.drives()
        robot.latched.add(None)
        await confirmed(robot)
        time.sleep(WINDOW)  # noqa: ASYNC251 - that is what is tested
        assert rig.base.tell("peak", seconds=WINDOW) < SLIP
        assert rig.base.tell("mean", seconds=WINDOW) < CREEP / 2


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
            assert await rig.rests() < SLIP
    finally:
        rig.stop()


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


async def released(robot: Robot) -> None:
    """Return once the reset is noticed."""
    await until(lambda: not robot.backend.stops.keeper.holds)


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
        assert await rig.rests() < SLIP


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
        rig.base.tell("put", name="frozen", value=True)
        await rig.until(lambda t: t["wheel"] == 0.0, 15.0)


async def test_a_goal_that_was_given_up_does_not_go_on_when_its_server_is_back(rig: Rig) -> None:
    async with gateway(rig, silence=1.0) as robot:
        goal = robot.input("action/navigate", {"nested_field": {"int32_value": 600}})
        running = asyncio.ensure_future(robot.backend.execute("action/navigate", goal, ignore))
        await rig.until(lambda t: t["running"] and t["wheel"] > 0.3)
        await asyncio.sleep(0.6)  # until the first look after the server is past
        rig.base.freeze()
        try:
            with pytest.raises((AdapterUnavailable, DeviceTimeout)):
                await asyncio.wait_for(running, BOUND)
        finally:
            rig.base.thaw()
        await rig.until(lambda t: not t["running"], 15.0)
        assert "held" in await robot.backend.recover(None)


async def test_what_an_earlier_gateway_began_is_ended_when_it_was_lost(rig: Rig) -> None:
    assert rig.commander.tell("go", steps=400)  # the earlier gateway's, as far as can be known
    await rig.until(lambda t: t["running"])
    async with gateway(rig) as robot:
        assert "all goals cancelled" in await robot.backend.recover(None)
        await rig.until(lambda t: not t["running"], 10.0)
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
