"""Several motors as one robot: joint positions, and moves that all joints make together."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Any

import anyio
import can
import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import rcp_can
from backends.can.rig import PATIENT, Node, Rig, channel, opened
from configuration import backend, key
from rcp_can import CanConfig
from rcp_can.path import Leg, Path
from rcp_can.sim import Bench, make_twin
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import OPERATOR, serve
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceTimeout,
    InvalidValue,
    ModeForbids,
    OutOfRange,
)

FOLLOW = "action/arm/follow_trajectory"
JOINTS, MOVE, STATES = "actuator/arm/joints", "action/arm/move_joints", "sensor/arm/joints"
PROFILES = {"pan": ("odrive", 1), "tilt": ("cia402", 5), "roll": ("mit", 9)}
"""A drive with trajectories of its own, one of CANopen, and one that does as it is told."""
CREEP = 0.016  # rad/s at most of a mini-cheetah that is told to rest: its 12 bits have no zero
LOST = (AdapterUnavailable, DeviceTimeout)
"""What a silent drive is called: without contact, or without a position, whichever is noticed first."""


class Arm(Rig):
    def __init__(self, rig: Rig, bench: Bench, name: str) -> None:
        super().__init__(rig.backend, rig.host)
        self.bench, self.channel = bench, name
        self.twins = dict(zip(PROFILES, bench.twins, strict=True))
        self.axes = self.backend.axes

    async def until(self, holds: Any, seconds: float = 60.0) -> None:
        with anyio.fail_after(seconds):
            while not holds():  # noqa: ASYNC110  # a twin lives in a thread that tells nobody
                await asyncio.sleep(0.002)

    def still(self) -> bool:
        return all(abs(twin.plant.velocity) < 0.1 for twin in self.twins.values())

    def moving(self, **positions: float) -> asyncio.Future[Any]:
        return asyncio.ensure_future(self.execute(MOVE, {"positions": positions}))


def positions(state: Any) -> dict[str, float]:
    found: dict[str, float] = msgspec.to_builtins(state)["positions"]
    return found


def tables(name: str) -> dict[str, Any]:
    motor = {"bus": "can0", "timeout": 1.0, "feedback_timeout": 1.0, "rate": 100}
    motor |= {"velocity": 2.0, "acceleration": 20.0}
    motors = {
        joint: {**motor, "profile": profile, "node": node, "position": [-6.0, 6.0]}
        for joint, (profile, node) in PROFILES.items()
    }
    motors["tilt"] |= PATIENT
    motors["roll"]["options"] = {"reply_id": 0x100}
    bus = {"interface": "virtual", "channel": name, "restart": 0.3}
    group = {"joints": list(PROFILES), "valid_for": 0.3}
    return {
        "buses": {"can0": bus},
        "motors": motors,
        "joint_groups": {"arm": group},
        "grace": 5.0,
    }


@asynccontextmanager
async def arm(*, enabled: bool = True, **group: Any) -> AsyncGenerator[Arm]:
    name = channel()
    line = can.Bus(name, "virtual", ignore_config=True)
    options: dict[str, Any] = {"mit": {"reply_id": 0x100}}
    twins = [make_twin(p, node, **options.get(p, {})) for p, node in PROFILES.values()]
    with Bench(line, twins) as bench:
        table = tables(name)
        table["joint_groups"]["arm"] |= group
        async with opened(table) as rig:
            found = Arm(rig, bench, name)
            if enabled:
                await found.ran("service/arm/enable")
            yield found


async def test_joints_are_told_together_and_go_where_they_are_told() -> None:
    async with arm() as rig:
        await rig.write(JOINTS, {"pan": 0.3, "tilt": -0.2, "roll": 0.1})
        plants = {name: twin.plant for name, twin in rig.twins.items()}
        await rig.until(lambda: abs(plants["pan"].position - 0.3) < 0.02)
        await rig.until(lambda: abs(plants["tilt"].position + 0.2) < 0.02)
        await rig.until(lambda: abs(plants["roll"].position - 0.1) < 0.02)
        there = pytest.approx({"pan": 0.3, "tilt": -0.2, "roll": 0.1}, abs=0.02)
        await rig.until(lambda: positions(rig.host.last(STATES)) == there)
        assert positions(await rig.backend.read(STATES)) == there


async def test_nothing_named_brings_all_joints_to_rest_on_their_way() -> None:
    async with arm() as rig:
        await rig.write(JOINTS, {"pan": 5.0, "tilt": 5.0, "roll": 5.0})
        await rig.until(lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()))
        await rig.write(JOINTS, {})
        await rig.until(rig.still)
        assert all(twin.plant.position < 4.0 for twin in rig.twins.values())
        await asyncio.sleep(0.2)
        assert rig.still()


async def test_a_joint_that_is_not_named_stays_where_it_is() -> None:
    async with arm() as rig:
        await rig.write(JOINTS, {"pan": 5.0, "roll": 5.0})
        await rig.until(lambda: rig.twins["pan"].plant.velocity > 1.0)
        await rig.write(JOINTS, {"roll": 5.0})
        await rig.until(lambda: abs(rig.twins["pan"].plant.velocity) < 0.1)
        await rig.until(lambda: rig.twins["roll"].plant.velocity > 1.0)
        assert abs(rig.twins["pan"].plant.velocity) < 0.1
        assert rig.twins["pan"].plant.position < 4.0


async def test_positions_are_taken_by_all_that_are_named_or_by_none() -> None:
    async with arm(enabled=False) as rig:
        await rig.ran("service/pan/enable")
        with pytest.raises(ModeForbids, match="'tilt' is disabled"):
            await rig.write(JOINTS, {"pan": 1.0, "tilt": 1.0})
        await rig.write(JOINTS, {"pan": 0.1})  # the others need not be enabled
        await rig.until(lambda: abs(rig.twins["pan"].plant.position - 0.1) < 0.02)
        await rig.write(JOINTS, {"pan": 0.0})
        await rig.until(lambda: abs(rig.twins["pan"].plant.position) < 0.01)
        await rig.write(JOINTS, {})
        await asyncio.sleep(0.1)
        assert all(abs(twin.plant.position) < 0.01 for twin in rig.twins.values())


async def test_a_move_of_joints_begins_and_ends_together_and_every_drive_has_said_so() -> None:
    async with arm() as rig:
        seen: list[tuple[float, float, float]] = []
        moving = rig.moving(pan=2.0, tilt=-1.0, roll=0.5)
        plants = [twin.plant for twin in rig.twins.values()]
        while not moving.done():
            await asyncio.sleep(0.01)
            seen.append(tuple(plant.position for plant in plants))  # type: ignore[arg-type]
        moved = msgspec.to_builtins(moving.result())["positions"]
        for joint, goal in (("pan", 2.0), ("tilt", -1.0), ("roll", 0.5)):
            assert moved[joint] == pytest.approx(goal, abs=0.02)
            assert rig.twins[joint].plant.position == pytest.approx(goal, abs=0.03)
        assert rig.still()
        assert all(rig.axes[joint].status.reached for joint in ("pan", "tilt"))
        for pan, tilt, roll in seen:  # in a straight line, as far as drives can follow
            assert abs(pan / 2.0 - tilt / -1.0) < 0.2
            assert abs(pan / 2.0 - roll / 0.5) < 0.2
        parts = [fraction for _, fraction in rig.feedback]
        assert parts == sorted(parts)
        assert len(parts) > 5


async def test_a_dry_run_of_a_move_knows_the_motors() -> None:
    async with arm(enabled=False) as rig:
        near = rig.typed(MOVE, {"positions": {"pan": 0.2}})
        with pytest.raises(ModeForbids):
            rig.backend.foresee(MOVE, near)
        await rig.ran("service/arm/enable")
        rig.backend.foresee(MOVE, near)
        with pytest.raises(InvalidValue):
            rig.backend.foresee(MOVE, rig.typed(MOVE, {"positions": {}}))


async def test_a_dry_run_of_a_trajectory_plans_it() -> None:
    async with arm() as rig:
        slow = {"points": [{"time": 2.0, "positions": {"pan": 0.2}}]}
        fast = {"points": [{"time": 0.01, "positions": {"pan": 1.0}}]}
        rig.backend.foresee(FOLLOW, rig.typed(FOLLOW, slow))
        with pytest.raises(OutOfRange):
            rig.backend.foresee(FOLLOW, rig.typed(FOLLOW, fast))


async def test_a_move_leaves_joints_alone_that_it_does_not_name() -> None:
    began = time.monotonic()
    async with arm() as rig:
        moved = await rig.ran(MOVE, {"positions": {"pan": 0.5}, "speed": 0.5})
        assert moved["duration"] > 0.5
        creeps = CREEP * (time.monotonic() - began)
        assert abs(rig.twins["roll"].plant.position) < 0.005 + creeps
        with pytest.raises(InvalidValue, match="no joint"):
            await rig.ran(MOVE, {"positions": {}})


async def test_a_cancelled_move_has_brought_every_joint_to_rest_before_it_ends() -> None:
    async with arm() as rig:
        moving = rig.moving(pan=5.0, tilt=5.0, roll=5.0)
        await rig.until(lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()))
        for name in ("actuator/pan/velocity", JOINTS):
            with pytest.raises(ModeForbids, match="driven by action/arm/move_joints"):
                await rig.write(name, 1.0 if name != JOINTS else {"tilt": 1.0})
        moving.cancel()
        await asyncio.wait((moving,), timeout=60)
        assert moving.cancelled()
        assert rig.still()
        assert all(twin.plant.position < 4.5 for twin in rig.twins.values())
        await asyncio.sleep(0.2)
        assert rig.still()


async def test_a_stop_of_the_joints_ends_the_move() -> None:
    async with arm() as rig:
        moving = rig.moving(pan=5.0, roll=-5.0)
        await rig.until(lambda: rig.twins["pan"].plant.velocity > 1.0)
        await rig.write(JOINTS, {})
        with pytest.raises(ModeForbids, match="a stop of 'arm'"):
            await asyncio.wait_for(moving, 60)
        assert rig.still()


async def test_a_stop_of_the_joints_ends_what_moves_one_of_them() -> None:
    async with arm() as rig:
        moving = asyncio.ensure_future(rig.execute("action/pan/move_to", {"position": 5.0}))
        await rig.until(lambda: rig.twins["pan"].plant.velocity > 1.0)
        await rig.write(JOINTS, {})
        with pytest.raises(ModeForbids, match="a stop of 'arm'"):
            await asyncio.wait_for(moving, 60)
        await rig.until(rig.still)
        assert rig.twins["pan"].plant.position < 4.5


@pytest.mark.parametrize("joint", PROFILES)
async def test_a_joint_that_fails_stops_all(joint: str) -> None:
    async with arm() as rig:
        moving = rig.moving(pan=5.0, tilt=5.0, roll=5.0)
        await rig.until(lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()))
        rig.twins[joint].silent = True
        with pytest.raises(LOST, match=joint):
            await asyncio.wait_for(moving, 60)
        others = [twin.plant for name, twin in rig.twins.items() if name != joint]
        for _ in range(60):  # the stop that is repeated to the lost one must not hold up the others
            assert all(abs(plant.velocity) < 0.3 for plant in others)
            await asyncio.sleep(0.005)
        with pytest.raises(LOST, match=joint):
            await rig.write(JOINTS, {})
        rig.twins[joint].silent = False
        await rig.host.until(lambda: all(axis.online for axis in rig.axes.values()))
        await rig.until(rig.still)
        await asyncio.sleep(0.2)
        assert rig.still()


async def test_a_halt_ends_the_move_of_all_joints() -> None:
    async with arm() as rig:
        moving = rig.moving(pan=5.0, tilt=5.0, roll=5.0)
        await rig.until(lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()))
        with anyio.fail_after(60):
            await rig.backend.halt()
        assert rig.still()
        with pytest.raises(ModeForbids, match="halted"):
            await asyncio.wait_for(moving, 60)
        assert rig.still()


async def test_bus_off_stops_the_move_and_nothing_moves_when_the_bus_is_back() -> None:
    async with arm() as rig:
        moving = rig.moving(pan=5.0, roll=5.0)
        await rig.until(lambda: rig.twins["roll"].plant.velocity > 1.0)
        with Node(rig.channel) as node:
            node.bus_off()
            with pytest.raises(AdapterUnavailable):
                await asyncio.wait_for(moving, 60)
            await rig.host.published_as("sensor/can/can0/state", state="error_active")
        await rig.until(rig.still)
        await asyncio.sleep(0.2)
        assert rig.still()


async def test_over_the_gateway_envelopes_limits_and_the_dead_man_hold_for_joints() -> None:
    name = channel()
    line = can.Bus(name, "virtual", ignore_config=True)
    twins = [make_twin("odrive", 1), make_twin("odrive", 2)]
    config = (
        backend(
            tenant="t",
            use="can",
            grace=5.0,
            buses={"can0": {"interface": "virtual", "channel": name}},
            motors={
                "pan": {
                    "bus": "can0",
                    "profile": "odrive",
                    "node": 1,
                    "position": [-2.0, 2.0],
                    "velocity": 2.0,
                },
                "tilt": {
                    "bus": "can0",
                    "profile": "odrive",
                    "node": 2,
                    "velocity": 2.0,
                    "acceleration": 20.0,
                },
            },
            joint_groups={"head": {"joints": ["pan", "tilt"], "valid_for": 1.0}},
        )
        + key("operator", OPERATOR)
        + """
[[envelopes]]
name = "slow"
roles = ["operator"]
paths = ["/tenant/*/action/head/move_joints"]
bounds = { speed = { max = 0.9 }, "positions.tilt" = { min = -1.0, max = 1.0, optional = true } }
"""
    )
    kind = next(iter(rcp_can.rcp_backends()))
    with Bench(line, twins):
        async with serve(config, kind) as served:
            client = served.client(OPERATOR)

            async def ask(operation: str, path: str, body: Any = None) -> Any:
                return await client.request(operation, f"/tenant/t/{path}", body=body, within=60.0)

            async def turns() -> bool:
                return abs(twins[1].plant.velocity) > 1.0

            async def rests() -> bool:
                return abs(twins[1].plant.velocity) < 0.05

            refused = await ask("execute", "action/head/move_joints", {"positions": {"pan": 1.0}})
            assert refused["error"]["code"] in ("out_of_range", "mode_forbids"), refused
            assert (await ask("execute", "service/head/enable"))["status"] == "completed"
            for positions in ({"tilt": 1.5}, {"pan": 2.5}):
                body = {"positions": positions, "speed": 0.5}
                refused = await ask("execute", "action/head/move_joints", body)
                assert refused["error"]["code"] == "out_of_range", refused
            body = {"positions": {"pan": 0.5, "tilt": -0.5}, "speed": 0.8}
            moved = await ask("execute", "action/head/move_joints", body)
            assert moved["body"]["positions"]["tilt"] == pytest.approx(-0.5, abs=0.02), moved
            await ask("write", "actuator/head/joints", {"tilt": 40.0})  # and then no more
            await eventually(turns, "it goes")
            await eventually(rests, "it rests")
            assert twins[1].plant.position < 5.0
            stood = await ask("read", "sensor/head/joints")
            assert stood["body"]["positions"]["pan"] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("joints", "words"),
    [(["nobody"], "no motor 'nobody'"), (["m", "m"], "twice"), ([], "length")],
)
def test_joints_must_be_motors(joints: list[str], words: str) -> None:
    motor = {"bus": "can0", "profile": "mit", "node": 1}
    table = {"buses": {"can0": {}}, "motors": {"m": motor}}
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert({**table, "joint_groups": {"arm": {"joints": joints}}}, CanConfig)


async def test_a_motor_that_takes_no_positions_is_no_joint() -> None:
    bus = {"interface": "virtual", "channel": channel()}
    table = {"buses": {"can0": bus}, "motors": {"m": {"bus": "can0", "profile": "vesc", "node": 1}}}
    with pytest.raises(ConfigError, match=r"'m' \(vesc\) has no position control"):
        async with opened({**table, "joint_groups": {"arm": {"joints": ["m"]}}}):
            pass


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


legs = st.builds(
    Leg,
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.floats(0.1, 20),
    st.floats(0.1, 100),
)


@given(st.lists(legs, min_size=1, max_size=4), st.floats(0, 1.2))
@example([Leg(0.0, 5e-324, 1.0, 1.0)], 1.2)
def test_no_joint_leaves_its_limits_and_all_end_together(all_: list[Leg], brake: float) -> None:
    clock = Clock()
    path = Path(all_, clock)
    follow = [path.follow(leg) for leg in all_]
    step = max(path.duration / 400, 1e-6)
    step = min(step, 0.09)
    seen: list[list[tuple[float, float]]] = []
    braked = False
    end = path.duration
    while not path.over:
        seen.append([one() for one in follow])
        clock.now += step
        if not braked and clock.now >= brake * end:
            braked = True
            path.brake()
    seen.append([one() for one in follow])
    for number, leg in enumerate(all_):
        points = [each[number] for each in seen]
        low, high = sorted((leg.start, leg.goal))
        for position, velocity in points:
            assert low - 1e-6 <= position <= high + 1e-6
            assert abs(velocity) <= leg.velocity * (1 + 1e-9)
        for (a, va), (b, vb) in pairwise(points):
            assert abs(vb - va) <= leg.acceleration * step * (1 + 1e-6) + 1e-9
            assert abs(b - a) <= leg.velocity * step * (1 + 1e-6) + 1e-9
        assert abs(points[-1][1]) < 1e-6 + leg.acceleration * step
        if brake > 1.0:
            assert math.isclose(points[-1][0], leg.goal, abs_tol=1e-6)
