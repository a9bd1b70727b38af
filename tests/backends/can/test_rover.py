"""A differential drive as a robot: where it goes, what it says, and what one wheel's fault does."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise
from typing import Any

import anyio
import can
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.can.rig import Node, channel, opened
from backends.can.rover import Rover, rover, rover_bench, tables
from rcp_can import CanConfig
from rcp_can.goal_control import Goal, GoalControl
from rcp_can.odometry import Place
from rcp_can.pace import Pace
from rcp_can.sim import Bench, make_twin
from rcp_can.wheel_ramp import WheelRamp
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    ModeForbids,
    OutOfRange,
    RcpError,
)
from rcp_kernel.values import to_plain

LOST = (AdapterUnavailable, DeviceTimeout)


async def test_forward_is_along_x_and_positive_yaw_is_to_the_left() -> None:
    async with rover() as rig:
        await rig.velocity(0.5, 0.5)
        await rig.until(lambda: rig.truth.moving == pytest.approx((0.5, 0.5), abs=0.02))

        def moves() -> bool:
            velocity = rig.host.last("sensor/velocity")
            found = velocity.linear.x, velocity.angular.z
            return found == pytest.approx((0.5, 0.5), abs=0.02)

        await rig.host.until(moves)
        await rig.velocity(0.0)
        await rig.until(rig.truth.still)
        await rig.host.until(lambda: abs(rig.host.last("sensor/velocity").linear.x) < 0.001)
        await rig.host.until(lambda: rig.place.y > 0.0)
        assert rig.place.x > 0.0
        assert rig.place.heading == pytest.approx(rig.truth.heading, abs=0.01)


speeds = st.tuples(st.floats(-10, 10), st.floats(-10, 10))
accelerations = st.none() | st.floats(2, 50)


@given(speeds, speeds, st.tuples(accelerations, accelerations), st.floats(0.01, 0.09))
def test_both_wheels_change_speed_in_the_same_time_within_their_accelerations(
    start: tuple[float, float],
    goal: tuple[float, float],
    limits: tuple[float | None, float | None],
    step: float,
) -> None:
    now = 0.0
    ramp = WheelRamp(start, goal, limits, Pace(0.1, lambda: now))
    last = start
    for _ in range(2000):
        now += step
        speed = tuple(ramp.follow(wheel)()[1] for wheel in (0, 1))
        parts = [
            (at - of) / (to - of)
            for at, of, to in zip(speed, start, goal, strict=True)
            if abs(to - of) > 1e-3
        ]
        assert max(parts, default=1.0) - min(parts, default=1.0) < 1e-6  # the curve is kept
        for at, before, limit in zip(speed, last, limits, strict=True):
            assert limit is None or abs(at - before) <= limit * step * (1 + 1e-6) + 1e-9
        last = speed
        if speed == goal:
            return
    assert last == pytest.approx(goal)


async def test_the_wheels_of_the_robot_share_a_ramp() -> None:
    async with rover() as rig:
        await rig.velocity(0.4, 1.0)
        left, right = (rig.backend.axes[name].ramp for name in ("left", "right"))
        assert left.path is not None
        assert right.path is not None
        await rig.until(lambda: left.path()[1] == 2.0)
        assert right.path()[1] == pytest.approx(6.0)


async def test_what_a_wheel_cannot_is_refused_and_the_speed_limit_slows_on_the_same_curve() -> None:
    async with rover() as rig:
        for forward, turn in ((1.5, 0.0), (0.0, 9.0), (0.8, 2.0)):
            with pytest.raises(OutOfRange):
                await rig.velocity(forward, turn)
        await rig.write("param/speed_limit", 0.2)
        taken = await rig.velocity(0.4, 0.6)
        assert (taken.linear.x, taken.angular.z) == pytest.approx((0.2, 0.3))
        await rig.until(lambda: rig.truth.moving[0] > 0.19)
        await rig.write("param/speed_limit", 0.1)  # and what is in force obeys it
        await rig.until(lambda: rig.truth.moving[0] < 0.11)
        assert await rig.backend.read("param/speed_limit") == 0.1
        with pytest.raises(OutOfRange):
            await rig.write("actuator/cmd_vel", {"linear": {"y": 0.1}})


@pytest.mark.parametrize("wheel", ["left", "right"])
async def test_one_wheel_that_is_off_refuses_for_both(wheel: str) -> None:
    async with rover() as rig:
        await rig.ran(f"service/{wheel}/disable")
        with pytest.raises(ModeForbids, match=f"'{wheel}' is disabled"):
            await rig.velocity(0.5)
        with pytest.raises(ModeForbids, match=f"'{wheel}' is disabled"):
            await rig.moving(1.0)
        assert rig.truth.still()
        await rig.velocity(0.0)  # a stop is taken all the same


async def test_a_drive_that_refuses_to_enable_leaves_the_other_off() -> None:
    async with rover(enabled=False) as rig:
        rig.right.refuses = True
        with pytest.raises(RcpError, match="node 2"):
            await rig.ran("service/enable")
        await rig.until(lambda: not rig.left.enabled)
        with pytest.raises(ModeForbids):
            await rig.velocity(0.5)


FAULTS = {
    "fault": lambda twin: twin.break_down(),
    "silence": lambda twin: setattr(twin, "silent", True),
    "reboot": lambda twin: twin.boot(),
    "blind": lambda twin: setattr(twin, "blind", True),
}


@pytest.mark.parametrize("what", FAULTS)
@pytest.mark.parametrize("wheel", ["left", "right"])
async def test_a_wheel_that_fails_stops_the_other_and_the_robot_says_why(
    wheel: str, what: str
) -> None:
    async with rover() as rig:
        await rig.velocity(0.5)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        twins = {"left": rig.left, "right": rig.right}
        failing = twins.pop(wheel)
        (other,) = twins.values()
        await rig.ordered(lambda: FAULTS[what](failing))
        await rig.host.until(rig.stops)
        await rig.until(lambda: abs(other.plant.velocity) < 0.1)
        (stop,) = rig.stops()
        assert stop.motor == wheel
        assert f"'{wheel}'" in stop.text
        with pytest.raises(RcpError, match="motor '"):
            await rig.velocity(0.5)
        assert abs(other.plant.velocity) < 0.1


async def test_a_wheel_lost_in_a_move_fails_it_and_says_which() -> None:
    async with rover() as rig:
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        rig.left.silent = True
        with pytest.raises(LOST, match="left"):
            await asyncio.wait_for(moving, 60)
        await rig.until(lambda: abs(rig.right.plant.velocity) < 0.1)


async def test_bus_off_stops_it_and_nothing_moves_when_the_bus_is_back() -> None:
    async with rover() as rig:
        await rig.velocity(0.5)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        before = rig.place
        with Node(rig.channel) as node:
            node.bus_off()
            await rig.host.published_as("sensor/can/can0/state", state="bus_off")
            assert rig.stops()
            await rig.host.published_as("sensor/can/can0/state", state="error_active")
        await rig.until(rig.truth.still)
        with pytest.raises(RcpError):
            await rig.velocity(0.5)
        assert rig.place.x >= before.x - 0.01


async def test_odometry_goes_on_without_a_jump_when_a_drive_has_rebooted() -> None:
    async with rover() as rig:
        await rig.moving(0.5)
        before = rig.place
        places = len(rig.host.events("sensor/pose"))

        def reboot() -> None:
            rig.left.boot()
            rig.left.plant.position = 0.0  # an incremental encoder

        await rig.ordered(reboot)
        axis = rig.backend.axes["left"]
        await rig.until(lambda: axis.configured and axis.position is not None)
        await rig.until(lambda: abs(axis.position) < 0.01)
        await rig.host.until(lambda: len(rig.host.events("sensor/pose")) > places + 20)
        for pose in rig.host.events("sensor/pose")[places:]:
            assert pose.position.x == pytest.approx(before.x, abs=0.01)
        await rig.ran("service/enable")
        await rig.moving(1.0)
        assert rig.place.x == pytest.approx(1.0, abs=0.06)


async def test_a_new_zero_of_a_wheel_is_no_motion_of_the_robot() -> None:
    async with rover() as rig:
        await rig.moving(0.3)
        before = rig.place
        await rig.ran("action/left/home")  # takes the present position as zero
        axis = rig.backend.axes["left"]
        await rig.until(lambda: abs(axis.position) < 0.01)
        places = len(rig.host.events("sensor/pose"))
        await rig.host.until(lambda: len(rig.host.events("sensor/pose")) > places + 5)
        assert rig.place == pytest.approx(before, abs=0.01)


async def test_reports_that_arrive_in_a_bunch_are_all_counted() -> None:
    async with rover() as rig:
        await rig.velocity(0.5)
        await rig.until(lambda: rig.truth.moving[0] > 0.45)
        loop = asyncio.get_running_loop()
        for _ in range(3):
            end = loop.time() + 0.1
            while loop.time() < end:  # a plugin that blocks
                pass
            await rig.velocity(0.5)
            await asyncio.sleep(0.05)
        await rig.velocity(0.0)
        await rig.until(rig.truth.still)
        await rig.host.until(lambda: abs(rig.place.x - rig.truth.way) < 0.01)
        assert rig.truth.way > 0.15


async def test_odometry_counts_what_the_wheels_turn_not_what_they_were_told() -> None:
    async with rover(enabled=False) as rig:
        await rig.host.until(lambda: rig.host.events("sensor/pose"))
        counted, turned = await pushed(rig)
        for _ in range(4):  # a gateway that is late by too much counts nothing, as after a gap
            if counted != pytest.approx(turned, abs=0.005):
                counted, turned = await pushed(rig)
        assert counted == pytest.approx(turned, abs=0.005)
        assert turned > 0.05


async def pushed(rig: Rover) -> tuple[float, float]:
    """Turn the wheels by hand; return how far it went by the odometry, and by the wheels, m."""
    before = rig.place.x, rig.truth.way

    def push() -> None:
        rig.left.plant.velocity, rig.right.plant.velocity = 5.0, -5.0

    def is_told() -> bool:
        wheels = (rig.left, rig.backend.axes["left"]), (rig.right, rig.backend.axes["right"])
        return all(abs(t.plant.position - a.status.position) < 0.003 for t, a in wheels)

    await rig.ordered(push)
    await rig.until(lambda: rig.left.plant.velocity == rig.right.plant.velocity == 0.0)
    await rig.until(is_told)
    places = len(rig.host.events("sensor/pose"))
    await rig.host.until(lambda: len(rig.host.events("sensor/pose")) > places + 1)
    return rig.place.x - before[0], rig.truth.way - before[1]


@pytest.mark.parametrize(
    ("x", "y", "yaw"), [(1.0, 0.0, None), (0.0, 0.6, 0.0), (-0.5, 0.1, math.pi), (0.0, 0.0, 1.5)]
)
async def test_move_to_ends_there_at_rest(x: float, y: float, yaw: float | None) -> None:
    async with rover() as rig:
        moved = to_plain(await rig.moving(x, y, yaw=yaw))
        assert rig.truth.still()
        assert math.hypot(rig.place.x - x, rig.place.y - y) < 0.06
        assert moved["error"] < 0.05
        assert moved["pose"]["frame_id"] == "odom"
        if yaw is not None:
            assert abs(math.remainder(rig.place.heading - yaw, 2 * math.pi)) < 0.06
        await rig.host.until(  # it is told once the last that the wheels turned is read
            lambda: abs(math.remainder(rig.truth.heading - rig.place.heading, 2 * math.pi)) < 0.01
        )


@pytest.mark.parametrize("beside", [0.037, 0.07])
def test_it_does_not_circle_around_a_goal_beside_it(beside: float) -> None:
    goal = Goal(1.0, 0.0, None, 0.05, 0.05)
    control = GoalControl(goal, turn_rate=1.5, acceleration=2.0, turn_acceleration=10.0)
    control.phase = "driving"
    forward, _ = control.step(Place(1.0, -beside, 0.1), 1.0)
    assert forward == 0.0
    assert control.phase == ("done" if beside < goal.tolerance else "turning")


@pytest.mark.parametrize("late", [0, 3, 5, 10])
def test_it_comes_to_its_heading_by_feedback_that_is_late(late: int) -> None:
    control = GoalControl(
        Goal(0.0, 0.0, 1.5, 0.05, 0.05), turn_rate=1.5, acceleration=2.0, turn_acceleration=10.0
    )
    heading, period = 0.0, 0.02
    for _ in range(4):
        under_way = [heading] * late
        while control.phase != "done":
            under_way.append(heading)
            _, turn = control.step(Place(0.0, 0.0, under_way.pop(0)), 1.0)
            heading += turn * period
        if control.reached(Place(0.0, 0.0, heading)):
            return
        control.again(Place(0.0, 0.0, heading))
    pytest.fail(f"it came to rest at {heading:.3f} rad")


async def test_distance_and_time_left_shrink_on_the_way() -> None:
    async with rover() as rig:
        await rig.moving(1.5, speed=0.6)
        received = [feedback for feedback, _ in rig.feedback]
        assert len(received) > 3
        distances = [each.distance_remaining for each in received]
        assert all(after < before + 0.01 for before, after in pairwise(distances))
        assert distances[-1] < distances[0] / 2
        assert received[0].eta > received[-1].eta
        assert received[0].eta == pytest.approx(3.0, abs=1.5)


async def test_a_cancelled_move_has_braked_when_it_ends() -> None:
    async with rover() as rig:
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(moving, 60)
        assert rig.truth.still()
        await rig.velocity(0.2)  # and the wheels are free again
        await rig.until(lambda: rig.truth.moving[0] > 0.15)


async def test_a_move_that_is_cancelled_as_something_else_ends_it_has_braked_when_it_ends() -> None:
    async with rover() as rig:
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        await rig.velocity(0.0)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(moving, 60)
        assert rig.truth.still()


async def test_a_velocity_that_is_renewed_right_before_each_set_point_is_reached() -> None:
    async with rover() as rig:
        with anyio.fail_after(60):
            while rig.truth.moving[0] < 0.45:
                await rig.velocity(0.5)
                await asyncio.sleep(0)


async def test_a_velocity_while_a_cancelled_move_brakes_is_not_stopped_by_it() -> None:
    async with rover() as rig:
        axes = rig.backend.axes
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.8)
        moving.cancel()
        await rig.until(lambda: axes["left"].leaving)
        await rig.velocity(0.4)
        await asyncio.wait((moving,), timeout=60)
        assert moving.cancelled()
        assert not any(axes[name].stopped for name in ("left", "right"))
        await rig.until(lambda: rig.truth.moving[0] == pytest.approx(0.4, abs=0.05))


async def test_a_velocity_of_zero_ends_the_move() -> None:
    async with rover() as rig:
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        with pytest.raises(ModeForbids, match="driven by action/move_to"):
            await rig.velocity(0.2)
        await rig.velocity(0.0)
        with pytest.raises(ModeForbids, match="velocity of zero"):
            await asyncio.wait_for(moving, 60)
        await rig.until(rig.truth.still)


async def test_a_jammed_wheel_ends_the_move_as_failed() -> None:
    async with rover() as rig:
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        for plant in (rig.left.plant, rig.right.plant):  # too weak for what is in its way
            plant.torque_limit, plant.stiction = 0.0, 1.0
        with pytest.raises(DeviceRejected):
            await asyncio.wait_for(moving, 60)
        await rig.until(rig.truth.still)


async def test_a_turn_that_is_jammed_ends_the_move_as_failed() -> None:
    async with rover() as rig:
        moving = rig.moving(-5.0)
        await rig.until(lambda: abs(rig.truth.moving[1]) > 0.4)
        for plant in (rig.left.plant, rig.right.plant):
            plant.torque_limit, plant.stiction = 0.0, 1.0
        with pytest.raises(DeviceRejected, match="no progress"):
            await asyncio.wait_for(moving, 60)


async def test_one_who_drives_a_wheel_and_one_who_drives_the_robot_do_not_mix() -> None:
    async with rover() as rig:
        await rig.velocity(0.3)
        with pytest.raises(ModeForbids, match="driven by actuator/cmd_vel"):
            await rig.write("actuator/left/velocity", 1.0)
        await rig.write("actuator/left/velocity", 0.0)  # a stop of one wheel is one of both
        await rig.until(rig.truth.still)
        assert rig.stops()
        await rig.write("actuator/left/velocity", 1.0)
        await rig.until(lambda: rig.left.plant.velocity > 0.9)
        turning = asyncio.ensure_future(rig.execute("action/left/move_to", {"position": 50.0}))
        await rig.until(lambda: rig.backend.axes["left"].owner)
        with pytest.raises(ModeForbids, match="driven by action/left/move_to"):
            await rig.velocity(0.3)
        assert abs(rig.right.plant.velocity) < 0.1
        turning.cancel()
        await asyncio.wait((turning,), timeout=60)


async def test_a_halt_in_a_move_stops_both_wheels() -> None:
    async with rover() as rig:
        moving = rig.moving(5.0)
        await rig.until(lambda: rig.truth.moving[0] > 0.4)
        with anyio.fail_after(60):
            await rig.backend.halt()
        assert rig.truth.still()
        with pytest.raises(ModeForbids, match="halted"):
            await asyncio.wait_for(moving, 60)
        assert rig.left.state == rig.right.state == "quick_stop"


async def test_a_reset_stops_it_and_begins_a_new_frame() -> None:
    async with rover() as rig:
        await rig.write("param/speed_limit", 0.5)
        await rig.velocity(0.4)
        await rig.until(lambda: rig.truth.way > 0.1)
        await rig.ran("service/reset_system")
        assert rig.truth.still()
        assert await rig.backend.read("param/speed_limit") == pytest.approx(1.0)
        pose: Any = await rig.backend.read("sensor/pose")
        assert abs(pose.position.x) < 0.01


async def test_a_reset_stops_the_arm_of_a_robot_that_has_lost_a_wheel() -> None:
    table = tables(channel())
    lift = {"bus": "can0", "profile": "cia402", "node": 3, "velocity": 5.0, "timeout": 1.0}
    lift["feedback_timeout"] = 1.0
    table["motors"]["lift"] = {**lift, "acceleration": 20.0, "rate": 100}
    table["joint_groups"] = {"mast": {"joints": ["lift"], "as_robot": True}}
    name = table["buses"]["can0"]["channel"]
    wheels, other = (can.Bus(name, "virtual", ignore_config=True) for _ in range(2))
    mast = make_twin("cia402", 3)
    with rover_bench(wheels) as bench, Bench(other, [mast]):
        async with opened(table) as rig:
            await rig.ran("service/enable")
            goal = {"positions": {"lift": 500.0}}
            moving = asyncio.ensure_future(rig.execute("action/move_joints", goal))
            with anyio.fail_after(60):
                while mast.plant.velocity < 2.0:  # noqa: ASYNC110  # a twin tells nobody
                    await asyncio.sleep(0.01)
            bench.twins[0].silent = True
            await rig.host.until(lambda: not rig.backend.axes["left"].online)
            with pytest.raises(AdapterUnavailable):
                await rig.ran("service/reset_system")
            with pytest.raises(ModeForbids, match="a reset ended the move"):
                await asyncio.wait_for(moving, 60)
            assert abs(mast.plant.velocity) < 0.1


async def test_a_goal_in_a_frame_without_a_transform_is_refused() -> None:
    async with rover() as rig:
        with pytest.raises(InvalidValue, match="no transform from 'earth'"):
            await rig.moving(1.0, frame="earth")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"right": "left"}, "the same motor"),
        ({"right": "nobody"}, "no motor 'nobody'"),
        ({"radius": 0}, "> 0|>= "),
    ],
)
def test_a_drive_that_is_none_is_refused(change: dict[str, Any], words: str) -> None:
    table = tables("none")
    table["diff_drives"]["base"] |= change
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(table, CanConfig)


def test_a_backend_is_one_robot() -> None:
    table = tables("none")
    table["diff_drives"]["second"] = dict(table["diff_drives"]["base"])
    with pytest.raises(msgspec.ValidationError, match="'base' is the robot already"):
        msgspec.convert(table, CanConfig)
