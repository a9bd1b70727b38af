"""When a sample that comes late was measured."""

from __future__ import annotations

import time

import pytest
from sensor_msgs.msg import JointState

from rcp_ros2.feedback import Joints
from rcp_ros2.stamps import Delays, Ticks

S = 1_000_000_000


@pytest.mark.parametrize("skew", [-7 * S, 0, 1800 * S])
def test_a_late_sample_was_measured_when_its_stamp_says_whatever_the_robots_clock_shows(
    skew: int,
) -> None:
    delays, began, stamp = Delays(), 1000.0, time.time_ns() + skew
    delays.measured(stamp, began)
    late = delays.measured(stamp + S // 10, began + 3.0)
    assert late == pytest.approx(began + 0.1, abs=1e-5)
    for second in range(4, 60):  # the clocks' difference is not forgotten
        at = began + second
        assert delays.measured(stamp + second * S, at) == pytest.approx(at, abs=1e-5)


@pytest.mark.parametrize(
    "stamp", [5 * S, time.time_ns() + 10**7 * S], ids=["since its start", "in the future"]
)
def test_a_clock_that_is_far_off_leaves_the_arrival(stamp: int) -> None:
    delays = Delays()
    assert [delays.measured(stamp, at) for at in (10.0, 20.0)] == [10.0, 20.0]


def test_a_clock_that_is_set_back_is_followed_from_then_on() -> None:
    delays, stamp = Delays(), time.time_ns()
    delays.measured(stamp, 10.0)
    assert delays.measured(stamp - 60 * S, 11.0) == 11.0
    assert delays.measured(stamp - 59 * S, 15.0) == pytest.approx(12.0, abs=1e-5)


def test_a_simulated_stamp_is_as_old_as_its_time_of_the_clock() -> None:
    ticks, before = Ticks(), time.monotonic()
    assert ticks.measured(S, before) == before
    ticks.add(S)
    after = time.monotonic()
    assert before <= ticks.measured(S, after + 9.0) <= after
    assert ticks.measured(2 * S, after + 9.0) == after + 9.0  # its time has not come yet
    ticks.add(S // 2)  # it begins again
    assert ticks.measured(S, after + 9.0) == after + 9.0


def test_a_speed_made_of_positions_is_that_between_their_measurements() -> None:
    joints = Joints(0.5)
    states = [(10.0, 0.0), (10.02, 0.01), (10.12, 0.06)]
    found = [joints.measure(JointState(name=["a"], position=[place]), at) for at, place in states]
    assert found[:2] == [None, None]
    assert found[2] is not None
    assert found[2].speeds[1] == pytest.approx(0.5)


def test_joints_are_measured_when_the_last_of_them_is() -> None:
    joints = Joints(0.5)
    joints.needed = frozenset("ab")
    assert joints.measure(JointState(name=["a"], velocity=[0.0]), 10.0) is None
    found = joints.measure(JointState(name=["b"], velocity=[0.0]), 10.3)
    assert found is not None
    assert found.at == 10.0
