"""Trajectories in joint space: the curves, the one clock, what is refused, and what ends them."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import anyio
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.can.rig import Node
from backends.can.test_joints import LOST, Arm, arm, tables
from rcp_can import CanConfig
from rcp_can.cubic import Cubic, Knot
from rcp_can.joint_limits import JointLimits
from rcp_can.joint_run import Follow
from rcp_can.path import Leg, Path
from rcp_can.trajectory import Trajectory
from rcp_can.trajectory_plan import Joint, Point, plan
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    InvalidValue,
    ModeForbids,
    OutOfRange,
)
from rcp_kernel.values import to_plain

FOLLOW, STATES = "action/arm/follow_trajectory", "sensor/arm/joint_states"
LATE = 0.015  # s
BEND = [Knot(0, 0, 0), Knot(0.5, 1), Knot(1.2, 0.3), Knot(2, 0.7, 0.2), Knot(3, 1), Knot(3.5, 0, 0)]


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


# Curves

knots = st.lists(
    st.tuples(st.floats(0.05, 2.0), st.floats(-3, 3), st.none() | st.floats(-2, 2)),
    min_size=1,
    max_size=6,
)


def through(steps: list[tuple[float, float, float | None]]) -> list[Knot]:
    found = [Knot(0.0, 0.0, 0.0)]
    for duration, position, velocity in steps:
        found.append(Knot(found[-1].time + duration, position, velocity))
    found[-1] = found[-1]._replace(velocity=0.0)
    return found


@given(knots)
def test_a_curve_goes_through_its_knots_and_jumps_nowhere(
    steps: list[tuple[float, float, float | None]],
) -> None:
    points = through(steps)
    curve = Cubic(points)
    for point in points:
        here = curve.at(point.time)
        assert here.position == pytest.approx(point.position, abs=1e-6)
        if point.velocity is not None:
            assert here.velocity == pytest.approx(point.velocity, abs=1e-5)
    for point in points[1:-1]:
        before, after = curve.at(point.time - 1e-9), curve.at(point.time)
        assert after.velocity == pytest.approx(before.velocity, abs=1e-3)
        if point.velocity is None:  # and the drive feels no jerk that nobody asked for
            assert after.acceleration == pytest.approx(before.acceleration, abs=1e-2)


@given(knots)
def test_no_sample_is_beyond_the_extremes(steps: list[tuple[float, float, float | None]]) -> None:
    points = through(steps)
    curve = Cubic(points)
    for number, (before, after) in enumerate(pairwise(points)):
        ends = curve.extremes(number)
        for step in range(101):
            at = before.time + (after.time - before.time) * step / 101
            for value, bounds in zip(curve.at(at), zip(*ends, strict=True), strict=True):
                assert min(bounds) - 1e-6 <= value <= max(bounds) + 1e-6


# The clock

limit = max(abs(s.acceleration) for n in range(5) for s in Cubic(BEND).extremes(n))


@given(st.lists(st.floats(0.0, 0.4), min_size=50, max_size=200))
def test_a_late_or_jittery_host_never_jumps(gaps: list[float]) -> None:
    clock = Clock()
    curve = Cubic(BEND)
    line = Trajectory([curve], [limit], 3.5, LATE, clock)
    follow = line.follow(0)
    fastest = max(abs(s.velocity) for n in range(curve.segments) for s in curve.extremes(n))
    last, _ = follow()
    for gap in gaps:
        clock.now += gap
        position, _ = follow()
        assert abs(position - last) <= fastest * min(gap, LATE) + 1e-9
        last = position


def shared(clock: Clock) -> tuple[Trajectory | Path, list[Follow], float]:
    curve = Cubic(BEND)
    line = Trajectory([curve] * 3, [limit] * 3, 3.5, LATE, clock)
    fastest = max(abs(s.velocity) for n in range(curve.segments) for s in curve.extremes(n))
    return line, [line.follow(joint) for joint in range(3)], fastest


def straight(clock: Clock) -> tuple[Trajectory | Path, list[Follow], float]:
    legs = [Leg(0.0, 4.0, 2.0, 20.0)] * 3
    path = Path(legs, clock, LATE)
    return path, [path.follow(leg) for leg in legs], 2.0


lines = pytest.mark.parametrize("make", [shared, straight])


@lines
@given(asked=st.lists(st.tuples(st.integers(0, 2), st.floats(0.0, 0.4)), min_size=50, max_size=200))
def test_no_joint_leaps_wherever_the_host_stands_still(
    make: Callable[[Clock], tuple[Trajectory | Path, list[Follow], float]],
    asked: list[tuple[int, float]],
) -> None:
    clock = Clock()
    _, follows, fastest = make(clock)
    last = [follow()[0] for follow in follows]
    for joint, gap in asked:
        clock.now += gap
        position, _ = follows[joint]()
        assert abs(position - last[joint]) <= fastest * LATE + 1e-9
        last[joint] = position


@lines
@given(cycles=st.lists(st.tuples(*[st.floats(0.0, 0.4)] * 3), min_size=10, max_size=60))
def test_joints_of_one_cycle_are_at_the_same_moment_wherever_the_host_stands_still(
    make: Callable[[Clock], tuple[Trajectory | Path, list[Follow], float]],
    cycles: list[tuple[float, float, float]],
) -> None:
    clock = Clock()
    _, follows, _ = make(clock)
    for gaps in cycles:
        found: list[float] = []
        for gap, follow in zip(gaps, follows, strict=True):
            clock.now += gap
            found.append(follow()[0])
        assert max(found) - min(found) < 1e-9


@lines
@pytest.mark.parametrize("lost", [0, 1, 2])
@given(moment=st.integers(1, 200))
def test_a_joint_that_drops_out_leaves_the_others_braking_as_with_it(
    make: Callable[[Clock], tuple[Trajectory | Path, list[Follow], float]], lost: int, moment: int
) -> None:
    def braked(members: Sequence[int]) -> list[tuple[float, float]]:
        """Return where the joint that is neither lost nor first goes, cycle by cycle."""
        clock = Clock()
        line, follows, _ = make(clock)
        found: list[tuple[float, float]] = []
        for cycle in range(2000):
            if cycle == moment:
                line.brake()
            for joint in (0, 1, 2) if cycle < moment else members:
                sample = follows[joint]()
                if joint == watched:
                    found.append(sample)
            if line.over:
                return found
            clock.now += 0.01
        raise AssertionError("it stalls")

    watched = (lost + 1) % 3
    with_it, without = braked([0, 1, 2]), braked([j for j in (0, 1, 2) if j != lost])
    assert len(with_it) == len(without)
    for one, two in zip(with_it, without, strict=True):
        assert one == pytest.approx(two, abs=1e-9)


@given(st.floats(0.0, 3.4), st.floats(0.8, 3.0))
def test_a_braked_trajectory_stays_on_its_curve_within_its_acceleration(
    moment: float, stronger: float
) -> None:
    clock = Clock()
    curve, step = Cubic(BEND), 0.002
    line = Trajectory([curve], [limit * max(1.0, stronger)], 3.5, LATE, clock)
    follow = line.follow(0)
    velocities: list[float] = []
    braked = 0.0
    while not line.over:
        clock.now += step
        if line.elapsed >= moment and not braked:
            line.brake()
            braked = clock.now
        position, velocity = follow()
        assert position == pytest.approx(curve.at(line.elapsed).position)
        velocities.append(velocity)
    assert line.elapsed <= 3.5
    for one, two in pairwise(velocities):
        assert abs(two - one) <= 1.1 * limit * max(1.0, stronger) * step + 1e-3 * limit


# What is refused

LIMITS = JointLimits(-2.0, 2.0, 2.0, 10.0)
HERE = {"a": Joint(0.0, LIMITS), "b": Joint(0.5, LIMITS)}


def point(time: float, /, velocities: dict[str, float] | None = None, **positions: float) -> Point:
    return Point(time, positions, velocities or {})


@pytest.mark.parametrize(
    ("points", "error", "words", "pointer"),
    [
        ([point(1.0)], InvalidValue, "names no joint", "/points/0/positions"),
        ([point(1.0, a=1), point(2.0, b=1)], InvalidValue, "same joints", "/points/1/positions"),
        ([point(1.0, a=1), point(1.0, a=1)], InvalidValue, "not later", "/points/1/time"),
        ([point(0.0, a=0.0)], InvalidValue, "longer than 0 s", "/points/0/time"),
        (
            [point(0.0, a=0.5), point(1.0, a=1)],
            InvalidValue,
            "0.5 rad away",
            "/points/0/positions/a",
        ),
        ([point(1.0, {"a": 0.1}, a=1)], InvalidValue, "not at rest", "/points/0/velocities"),
        ([point(1.0, {"b": 0.0}, a=1)], InvalidValue, "no position, of b", "/points/0/velocities"),
        ([point(9.0, a=2.5)], OutOfRange, "position of joint 'a'", "/points/0"),
        ([point(1.0, a=1.9)], OutOfRange, "acceleration of joint 'a'", "/points/0"),
        ([point(1.2, a=1.9)], OutOfRange, "velocity of joint 'a'", "/points/0"),
        (
            [point(2.0, {"a": 1.9}, a=1.5), point(4.0, a=1.9)],
            OutOfRange,
            "position of joint 'a' exceeds allowed range: 2",
            "/points/1",
        ),
    ],
)
def test_what_a_joint_could_not_follow_is_refused(
    points: list[Point], error: Any, words: str, pointer: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        plan(points, HERE, 0.1)
    assert caught.value.details["pointer"] == pointer


def test_a_point_at_the_start_is_where_the_joints_are() -> None:
    curves = plan([point(0.0, a=0.05), point(2.0, a=1.0)], HERE, 0.1)
    assert curves["a"].at(0.0).position == 0.0


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"nobody": {}}, "contains 'nobody'"),
        ({"pan": {"position": [1.0, -1.0]}}, "lowest < highest"),
        ({"pan": {"velocity": 0.0}}, "> 0"),
    ],
)
def test_limits_of_no_joint_are_refused(limits: dict[str, Any], words: str) -> None:
    table = tables("none")
    table["joint_groups"]["arm"]["limits"] = limits
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(table, CanConfig)


# On the bus


def trajectory(*points: tuple[float, dict[str, float]]) -> dict[str, Any]:
    return {"points": [{"time": time, "positions": positions} for time, positions in points]}


WAVE = trajectory(
    (0.8, {"pan": 0.6, "tilt": -0.4, "roll": 0.3}),
    (1.6, {"pan": 0.2, "tilt": 0.2, "roll": 0.6}),
    (2.4, {"pan": 0.5, "tilt": 0.4, "roll": 0.0}),
)
FAR = trajectory((3.5, {"pan": 4.0, "tilt": 4.0, "roll": 4.0}))


def following(rig: Arm, goal: dict[str, Any]) -> asyncio.Future[Any]:
    return asyncio.ensure_future(rig.execute(FOLLOW, goal))


async def in_motion(rig: Arm, goal: dict[str, Any] = FAR) -> asyncio.Future[Any]:
    running = following(rig, goal)
    await rig.until(
        lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()) or running.done()
    )
    assert not running.done(), running.exception()
    return running


async def test_joints_are_at_each_waypoint_at_its_time_and_end_at_the_last() -> None:
    async with arm() as rig:
        moved = to_plain(await asyncio.wait_for(following(rig, WAVE), 30))
        for name, position in WAVE["points"][-1]["positions"].items():
            assert rig.twins[name].plant.position == pytest.approx(position, abs=0.02)
            assert moved["positions"][name] == pytest.approx(position, abs=0.02)
        assert moved["duration"] >= 2.4
        assert rig.still()
        received = [feedback for feedback, _ in rig.feedback if hasattr(feedback, "error")]
        assert len(received) > 5
        assert [each.time for each in received] == sorted(each.time for each in received)
        assert max(each.positions["roll"] for each in received) > 0.4  # it passed the second
        states = to_plain(await rig.backend.read(STATES))
        assert states["name"] == ["pan", "tilt", "roll"]
        assert states["position"][0] == pytest.approx(0.5, abs=0.02)


async def test_what_is_refused_moves_nothing() -> None:
    async with arm() as rig:
        for goal, error in (
            (trajectory((0.1, {"pan": 1.0})), OutOfRange),
            (trajectory((1.0, {"pan": 1.0}), (2.0, {"tilt": 1.0})), InvalidValue),
            (trajectory((1.0, {"pan": 7.0})), OutOfRange),
        ):
            taken = {name: len(twin.commands) for name, twin in rig.twins.items()}
            with pytest.raises(error):
                await rig.execute(FOLLOW, goal)
            assert all(axis.owner is None for axis in rig.axes.values())
            for name, twin in rig.twins.items():
                sent = twin.commands[taken[name] :]
                # 0.016 rad/s is as near to zero as the 12 bits of an MIT frame get
                assert not [value for _, value in sent if abs(value) >= 0.02], (name, sent)
        await rig.ran("service/tilt/disable")
        with pytest.raises(ModeForbids, match="'tilt' is disabled"):
            await rig.execute(FOLLOW, WAVE)
        assert rig.still()


STOPS = {
    "a stop of the joints": lambda rig: rig.write("actuator/arm/joints", {}),
    "a hold": lambda rig: rig.backend.hold(None),
    "a halt": lambda rig: rig.backend.halt(),
}


@pytest.mark.parametrize("stop", STOPS)
async def test_what_stops_the_joints_while_it_is_planned_is_not_overtaken(
    stop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    going_on = threading.Event()

    def slowly(*given: Any) -> Any:
        going_on.wait(20)
        return plan(*given)

    monkeypatch.setattr("rcp_can.joint_group.plan", slowly)
    async with arm() as rig:
        running = following(rig, FAR)
        await rig.until(lambda: rig.axes["pan"].owner)
        await STOPS[stop](rig)
        going_on.set()
        with pytest.raises(ModeForbids):
            await asyncio.wait_for(running, 60)
        assert rig.still()
        assert all(twin.plant.position < 0.1 for twin in rig.twins.values())


async def test_a_joint_that_is_held_back_aborts_the_trajectory_to_a_stop() -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        rig.twins["roll"].plant.torque_limit = 0.0
        rig.twins["roll"].plant.stiction = 1.0
        rig.twins["roll"].plant.friction = 1.0
        with pytest.raises(DeviceRejected, match=r"'roll' is .* off its trajectory"):
            await asyncio.wait_for(running, 60)
        assert rig.still()
        assert all(twin.plant.position < 3.9 for twin in rig.twins.values())
        assert all(axis.owner is None for axis in rig.axes.values())


async def test_a_host_that_stands_still_resumes_without_a_leap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # However long a busy machine lets it stand besides, no joint is given up.
    async with arm(tracking_tolerance=10.0) as rig:
        sent: dict[str, list[float]] = {name: [] for name in rig.axes}
        stalls: list[float] = []

        def noting(name: str, command: Callable[[Any, float, float], None]) -> Any:
            def note(mode: Any, value: float, velocity: float) -> None:
                sent[name].append(value)
                command(mode, value, velocity)
                if name == "tilt" and stalls:  # and again before the next joint's turn
                    time.sleep(stalls.pop())

            return note

        for name, axis in rig.axes.items():
            monkeypatch.setattr(axis.drive, "command", noting(name, axis.drive.command))
        running = await in_motion(rig)
        stalls.append(0.05)
        loop = asyncio.get_running_loop()
        end = loop.time() + 0.05
        while loop.time() < end:  # a plugin that blocks
            pass
        await asyncio.wait_for(running, 60)
        assert not stalls
        fastest = 1.5 * 4.0 / 3.5  # of a cubic from rest to rest
        for name, values in sent.items():
            steps = [abs(two - one) for one, two in pairwise(values)]
            assert max(steps) <= fastest * LATE + 1e-6, name
            assert rig.twins[name].plant.position == pytest.approx(4.0, abs=0.02)


@pytest.mark.parametrize("joint", ["pan", "tilt", "roll"])
async def test_a_joint_that_is_lost_stops_all(joint: str) -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        rig.twins[joint].silent = True
        with pytest.raises(LOST):
            await asyncio.wait_for(running, 60)
        others = [twin.plant for name, twin in rig.twins.items() if name != joint]
        await rig.until(lambda: all(abs(plant.velocity) < 0.1 for plant in others))
        rig.twins[joint].silent = False
        await rig.until(rig.still)


async def test_bus_off_ends_a_trajectory_and_nothing_goes_on_when_the_bus_is_back() -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        with Node(rig.channel) as node:
            node.bus_off()
            with pytest.raises(AdapterUnavailable):
                await asyncio.wait_for(running, 60)
            await rig.host.published_as("sensor/can/can0/state", state="error_active")
        await rig.until(rig.still)
        stood = {name: twin.plant.position for name, twin in rig.twins.items()}
        await asyncio.sleep(0.2)
        for name, twin in rig.twins.items():
            assert twin.plant.position == pytest.approx(stood[name], abs=0.02)


async def test_a_halt_ends_a_trajectory() -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        with anyio.fail_after(60):
            await rig.backend.halt()
        assert rig.still()
        with pytest.raises(ModeForbids, match="halted"):
            await asyncio.wait_for(running, 60)
        assert rig.still()


async def test_a_cancelled_trajectory_has_braked_on_its_curve() -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        running.cancel()
        await asyncio.wait((running,), timeout=60)
        assert running.cancelled()
        assert rig.still()
        ends = [twin.plant.position for twin in rig.twins.values()]
        assert max(ends) < 3.9
        assert max(ends) - min(ends) < 0.05  # the same curve for all: none has left it


async def test_one_trajectory_at_a_time_and_no_joint_of_it_for_others() -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        for name, value in (
            ("actuator/pan/position", 0.0),
            ("actuator/arm/joints", {"pan": 0.0}),
        ):
            with pytest.raises(ModeForbids, match="driven by action/arm/follow_trajectory"):
                await rig.write(name, value)
        with pytest.raises(ModeForbids, match="driven by"):
            await rig.execute("action/arm/move_joints", {"positions": {"pan": 0.0}})
        await rig.write("actuator/arm/joints", {})
        with pytest.raises(ModeForbids, match="a stop of 'arm'"):
            await asyncio.wait_for(running, 60)
        assert rig.still()


async def test_a_drive_that_cannot_follow_goes_into_fault_and_the_others_stop() -> None:
    async with arm() as rig:
        running = await in_motion(rig)
        twin: Any = rig.twins["tilt"]

        def tight() -> None:  # 1 mrad, for 10 ms: what a drive that was set up for its load has
            twin.local.set_data(0x6065, 0, round(twin.scale / 1000).to_bytes(4, "little"))
            twin.local.set_data(0x6066, 0, (10).to_bytes(2, "little"))

        rig.bench.order(tight)
        with pytest.raises(ModeForbids, match=r"'tilt' is no longer enabled: .*0x8611"):
            await asyncio.wait_for(running, 60)
        await rig.until(rig.still)
        assert twin.state == "fault"
