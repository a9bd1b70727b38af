"""The controller and the planner: goals are reached, limits kept, obstacles avoided."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rcp_kernel.errors import DeviceRejected, ModeForbids
from rcp_sim import SimConfig
from rcp_sim.config import Start
from rcp_sim.messages import Box
from rcp_sim.planner import Planner
from rcp_sim.rover import RADIUS
from rcp_sim.simulation import Simulation, Trip
from rcp_sim.world import WAREHOUSE

PLANNER = Planner(WAREHOUSE)
place = st.tuples(st.floats(-19.6, 19.6), st.floats(-19.6, 19.6)).filter(lambda p: PLANNER.free(*p))


def ride(sim: Simulation, trip: Trip, seconds: float = 400) -> float:
    """Drive a trip to its end; return the highest speed on the way."""
    top = 0.0
    for _ in range(round(seconds / 0.02)):
        if trip.done:
            return top
        sim.step(0.02)
        top = max(top, abs(sim.rover.v))
        assert sim.world.clearance(sim.rover.x, sim.rover.y) >= RADIUS - 1e-6
    raise AssertionError("never arrived")


@settings(max_examples=60)
@given(place, place, st.floats(-3, 3), st.floats(0.1, 2.5), st.sampled_from([0.02, 0.1, 0.5]))
def test_goals_are_reached_from_anywhere_below_the_speed_limit(
    start: tuple[float, float],
    goal: tuple[float, float],
    yaw: float,
    limit: float,
    tolerance: float,
) -> None:
    assume(math.dist(start, goal) / limit < 200)
    sim = Simulation(SimConfig(start=Start(x=start[0], y=start[1], yaw=yaw)))
    sim.set_limit(limit)
    trip = sim.go(*goal, tolerance=tolerance)
    assert ride(sim, trip) <= limit + 1e-9
    assert trip.failure is None
    assert math.dist((sim.rover.x, sim.rover.y), goal) <= tolerance
    assert sim.rover.at_rest


@given(place, place)
@settings(max_examples=200)
def test_ways_keep_their_distance_and_are_no_longer_than_needed(
    start: tuple[float, float], goal: tuple[float, float]
) -> None:
    way = PLANNER.find_path(start, goal)
    assert way is not None
    assert way[-1] == goal
    points = [start, *way]
    assert all(PLANNER.clear(a, b) for a, b in zip(points, way, strict=False))
    length = sum(math.dist(a, b) for a, b in zip(points, way, strict=False))
    assert length <= 2 * math.dist(start, goal) + 15


def test_the_wanted_heading_is_taken_at_the_goal() -> None:
    sim = Simulation(SimConfig())
    ride(sim, sim.go(3, 2, yaw=-2.0))
    assert sim.rover.yaw == pytest.approx(-2.0, abs=0.03)


def test_a_trip_may_be_slower_than_the_limit() -> None:
    sim = Simulation(SimConfig())
    assert ride(sim, sim.go(4, 0, speed=0.3)) <= 0.3


@pytest.mark.parametrize("goal", [(8, 7), (10, 10), (19.9, 0), (25, 0), (0, -20.5)])
def test_goals_in_or_at_solid_things_are_refused(goal: tuple[float, float]) -> None:
    sim = Simulation(SimConfig())
    with pytest.raises(DeviceRejected, match="obstacle or wall"):
        sim.go(*goal)
    assert sim.trip is None


def test_a_goal_walled_in_has_no_way() -> None:
    sim = Simulation(SimConfig())
    for box in ((0, 7, 4, 1), (0, 3, 4, 1), (-2, 5, 1, 5), (2, 5, 1, 5)):
        sim.place(Box(*map(float, box)))
    with pytest.raises(DeviceRejected, match="no path to"):
        sim.go(0, 5)


def test_a_box_in_the_way_is_driven_round() -> None:
    sim = Simulation(SimConfig())
    trip = sim.go(6, 0)
    for _ in range(100):
        sim.step(0.02)
    sim.place(Box(4, 0.3, 0.5, 3))
    ride(sim, trip)
    assert trip.failure is None
    assert sim.rover.travelled > 6.2


def test_a_way_shut_on_the_drive_ends_it() -> None:
    sim = Simulation(SimConfig())
    trip = sim.go(0, 5)
    for _ in range(20):
        sim.step(0.02)
    for box in ((0, 7, 4, 1), (0, 3, 4, 1), (-2, 5, 1, 5), (2, 5, 1, 5)):
        sim.place(Box(*map(float, box)))
    assert trip.failure == "the path is blocked"
    for _ in range(100):
        sim.step(0.02)
    assert sim.rover.at_rest


def test_running_into_something_stops_and_is_told_once() -> None:
    sim = Simulation(SimConfig(start=Start(x=18)))
    for _ in range(300):
        sim.drive(1.0, 0.0)
        sim.step(0.02)
    assert sim.rover.at_rest
    assert [(fault, active) for fault, active, _ in sim.happenings] == [("collision", True)]
    sim.drive(-0.5, 0.0)
    for _ in range(30):
        sim.step(0.02)
    assert sim.happenings[-1][:2] == ("collision", False)


def test_a_box_at_the_bumper_ends_a_trip() -> None:
    sim = Simulation(SimConfig())
    sim.set_limit(2.5)
    trip = sim.go(9, 0)
    while sim.rover.v < 2.4:
        sim.step(0.02)
    sim.place(Box(sim.rover.x + 0.5, 0, 0.2, 8))
    while not trip.done:
        sim.step(0.02)
    assert trip.failure == "blocked: the bumper touches an obstacle"


def test_a_drive_starting_in_a_margin_first_leaves_it() -> None:
    sim = Simulation(SimConfig(start=Start(x=18)))
    sim.drive(1.0, 0.0)
    while not sim.rover.bumped:
        sim.step(0.02)
    trip = sim.go(10, 5)
    ride(sim, trip)
    assert trip.failure is None


def test_the_speed_limit_holds_for_direct_velocities_too() -> None:
    sim = Simulation(SimConfig())
    assert sim.drive(2.0, 0.1) == (1.0, 0.1)
    sim.set_limit(0.4)
    assert sim.velocity == (0.4, 0.1)
    for _ in range(100):
        sim.step(0.02)
    assert sim.rover.v == pytest.approx(0.4)


def test_a_speed_limit_of_zero_pauses_a_trip() -> None:
    sim = Simulation(SimConfig())
    trip = sim.go(3, 0)
    for _ in range(50):
        sim.step(0.02)
    sim.set_limit(0)
    for _ in range(3000):
        sim.step(0.02)
    assert sim.rover.at_rest
    assert not trip.done
    sim.set_limit(1)
    ride(sim, trip)
    assert trip.failure is None


def test_a_trip_and_a_direct_velocity_exclude_each_other() -> None:
    sim = Simulation(SimConfig())
    trip = sim.go(5, 0)
    with pytest.raises(ModeForbids, match="action/move_to is running"):
        sim.drive(0.5, 0)
    with pytest.raises(ModeForbids, match="is running"):
        sim.go(1, 1)
    sim.drive(0, 0)
    assert trip.failure == "stopped by actuator/cmd_vel"


def test_the_end_of_a_velocity_does_not_end_the_trip_that_took_over_but_a_zero_does() -> None:
    sim = Simulation(SimConfig())
    sim.drive(0.5, 0)
    trip = sim.go(5, 0)
    sim.step(0.5)
    sim.end_velocity()
    assert not trip.done
    sim.drive(0, 0)
    assert trip.done


def test_an_empty_battery_stops_the_rover_and_refuses_to_drive() -> None:
    sim = Simulation(SimConfig())
    sim.pack.energy = 0.02
    trip = sim.go(9, 0)
    for _ in range(2000):
        sim.step(0.02)
    assert trip.failure == "the battery is empty"
    assert sim.rover.at_rest
    with pytest.raises(DeviceRejected, match="battery is empty"):
        sim.drive(0.1, 0)
    assert ("battery_empty", True) in [h[:2] for h in sim.happenings]
    assert ("battery_low", True) in [h[:2] for h in sim.happenings]


def test_charging_takes_the_warnings_back() -> None:
    sim = Simulation(SimConfig())
    sim.pack.energy = 0.0
    sim.step(0.02)
    sim.plug_in()
    sim.step(600)
    assert ("battery_low", False) in [h[:2] for h in sim.happenings]
    assert ("battery_empty", False) in [h[:2] for h in sim.happenings]
