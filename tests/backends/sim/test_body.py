"""The rover's body, battery and world, without a gateway."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_sim import SimConfig
from rcp_sim.battery import Pack
from rcp_sim.messages import Box
from rcp_sim.rover import ACCEL, BRAKE, RADIUS, Rover
from rcp_sim.simulation import Simulation
from rcp_sim.world import WAREHOUSE, Rect, World

EMPTY = World(40, 40)


def drive(rover: Rover, v: float, w: float, seconds: float, world: World = EMPTY) -> None:
    for _ in range(round(seconds * 100)):
        rover.step(0.01, v, w, world.clearance)


def test_a_straight_drive_ends_where_speed_times_time_says() -> None:
    rover = Rover(0, 0, math.pi / 2)
    drive(rover, 1.0, 0.0, 5.0)
    assert rover.v == 1.0
    assert rover.y == pytest.approx(5.0 - 0.5 / ACCEL, abs=1e-6)
    assert rover.x == pytest.approx(0.0, abs=1e-9)


def test_a_turning_drive_goes_round_a_circle_of_v_over_w() -> None:
    rover = Rover(0, 0, 0)
    rover.v, rover.w = 1.0, 0.5
    drive(rover, 1.0, 0.5, 2 * math.pi / 0.5)
    assert math.hypot(rover.x, rover.y) < 0.02
    assert rover.travelled == pytest.approx(2 * math.pi * 2.0, rel=1e-3)


@given(
    st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=20),
    st.sampled_from([0.001, 0.01, 0.02]),
)
def test_accelerations_stay_within_what_the_motors_give(
    commands: list[tuple[float, float]], dt: float
) -> None:
    rover = Rover(0, 0, 0)
    for v, w in commands:
        for _ in range(10):
            before = rover.v
            rover.step(dt, v, w, EMPTY.clearance)
            speeding = abs(rover.v) > abs(before)
            assert abs(rover.v - before) <= (ACCEL if speeding else BRAKE) * dt + 1e-9
            assert abs(rover.v) <= 2.5
            assert abs(rover.w) <= 2.0


def test_a_wall_stops_the_rover_and_it_can_back_away() -> None:
    rover = Rover(17, 0, 0)
    drive(rover, 1.0, 0.0, 6.0)
    assert rover.bumped
    assert rover.v == 0.0
    assert 20 - rover.x == pytest.approx(RADIUS, abs=0.02)
    drive(rover, -1.0, 0.0, 3.0)
    assert not rover.bumped
    assert rover.x < 19


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_clearance_agrees_with_the_boxes(x: float, y: float) -> None:
    clearance = WAREHOUSE.clearance(x, y)
    inside = any(box.holds(x, y) for box in WAREHOUSE.obstacles)
    assert (clearance < 0) == inside or clearance == pytest.approx(0, abs=1e-9)
    for box in WAREHOUSE.obstacles:
        dx = max(box.left - x, x - box.right, 0)
        dy = max(box.bottom - y, y - box.top, 0)
        assert clearance <= math.hypot(dx, dy) + 1e-9


def test_the_map_shows_walls_boxes_and_free_floor() -> None:
    world = World(10, 6, [Rect.of(Box(x=2, y=1, size_x=1, size_y=2))])
    columns, rows, data = world.grid(0.1)
    assert (columns, rows, len(data)) == (100, 60, 6000)

    def cell(x: float, y: float) -> int:
        return data[int((y + 3) / 0.1) * columns + int((x + 5) / 0.1)]

    assert cell(2, 1) == cell(1.55, 0.05) == cell(2.45, 1.95) == 100
    assert cell(1.45, 1) == cell(2, -0.05) == cell(-2, 1) == 0
    assert cell(-4.99, 0) == cell(4.99, 0) == cell(0, -2.99) == cell(0, 2.99) == 100


def test_the_map_of_the_warehouse_has_a_few_megabytes() -> None:
    columns, rows, data = WAREHOUSE.grid(SimConfig().map_resolution)
    assert columns == rows == 2000
    assert len(data) == 4_000_000
    assert set(data) == {0, 100}


def test_the_battery_drains_faster_when_moving() -> None:
    idle, moving = Pack(10, 1), Pack(10, 1)
    for _ in range(100):
        idle.step(1.0, 0, 0)
        moving.step(1.0, 1.0, 0.5)
    assert idle.charge < 1
    assert moving.charge < idle.charge
    assert moving.voltage < idle.voltage
    assert moving.current < idle.current < 0


def test_the_battery_never_leaves_its_bounds() -> None:
    pack = Pack(0.1, 0.5)
    pack.step(1e5, 2.5, 0)
    assert pack.energy == 0
    pack.charging = True
    pack.step(1e5, 0, 0)
    assert pack.charge == 1.0


def test_the_same_commands_give_the_same_run() -> None:
    def run() -> list[tuple[float, ...]]:
        sim = Simulation(SimConfig(seed=7))
        trace = []
        sim.go(6, -3, yaw=1.0)
        for step in range(1500):
            if step == 700:
                sim.stop("enough")
                sim.drive(0.7, -0.3)
            sim.step(0.02)
            rover = sim.rover
            trace.append((rover.x, rover.y, rover.yaw, rover.v, rover.w, sim.pack.energy))
        return trace

    assert run() == run()


def test_the_rate_of_the_steps_hardly_changes_the_run() -> None:
    ends = []
    for dt in (0.001, 0.02, 0.1):
        sim = Simulation(SimConfig())
        sim.drive(0.8, 0.3)
        for _ in range(round(6 / dt)):
            sim.step(dt)
        ends.append((sim.rover.x, sim.rover.y))
    assert all(math.dist(ends[0], end) < 0.02 for end in ends[1:])
