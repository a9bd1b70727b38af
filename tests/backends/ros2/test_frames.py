"""The tree of frames: what is where in what, and when."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_ros2.frames import Extrapolation, Frames, NotConnected, Place, UnknownFrame

HALF = math.sqrt(0.5)
S = 1_000_000_000


def at(x: float = 0, y: float = 0, z: float = 0, yaw: float = 0) -> Place:
    return Place(x, y, z, 0, 0, math.sin(yaw / 2), math.cos(yaw / 2))


def near(found: Place, wanted: Place) -> bool:
    """Compare; a quaternion and its negative turn alike."""
    dot = sum(a * b for a, b in zip(found[3:], wanted[3:], strict=True))
    straight = zip(found[:3], wanted[:3], strict=True)
    return abs(abs(dot) - 1) < 1e-6 and all(abs(a - b) < 1e-6 for a, b in straight)


def tree(*, buffer: float = 10) -> Frames:
    """map → odom → base_link → camera; the base drives one metre a second, from 100 s to 105 s."""
    frames = Frames(buffer)
    frames.put("odom", "map", 0, at(1, 0, 0, math.pi / 2), static=True)
    for second in range(100, 106):
        frames.put("base_link", "odom", second * S, at(second - 100), static=False)
    frames.put("camera", "base_link", 0, at(0, 0, 1), static=True)
    return frames


def test_a_chain_is_joined_in_both_directions() -> None:
    frames = tree()
    place, time = frames.lookup("map", "camera")
    assert time == 105 * S
    assert near(place, at(1, 5, 1, math.pi / 2))
    back, _ = frames.lookup("camera", "map")
    assert near(back, at(-5, 1, -1, -math.pi / 2))
    assert frames.lookup("base_link", "camera") == (at(0, 0, 1), None)


def test_two_branches_meet_where_they_part() -> None:
    frames = tree()
    frames.put("lidar", "base_link", 0, at(2), static=True)
    assert frames.lookup("lidar", "camera") == (at(-2, 0, 1), None)  # nothing between them moves


def test_a_time_between_two_is_interpolated() -> None:
    frames = tree()
    place, time = frames.lookup("odom", "base_link", 102 * S + S // 4)
    assert near(place, at(2.25))
    assert time == 102 * S + S // 4
    frames.put("wheel", "base_link", 104 * S, at(yaw=3.0), static=False)
    frames.put("wheel", "base_link", 105 * S, at(yaw=-3.0), static=False)  # the short way round
    middle, _ = frames.lookup("base_link", "wheel", 104 * S + S // 2)
    assert near(middle, at(yaw=math.pi))


def test_a_time_outside_is_refused_with_the_times_that_are_known() -> None:
    with pytest.raises(Extrapolation) as caught:
        tree().lookup("map", "camera", 106 * S)
    error = caught.value
    assert (error.child, error.first, error.last) == ("base_link", 100 * S, 105 * S)


def test_an_unknown_frame_is_refused_with_those_that_sound_alike() -> None:
    with pytest.raises(UnknownFrame) as caught:
        tree().lookup("map", "camara")
    assert caught.value.near[0] == "camera"


def test_two_trees_are_not_connected() -> None:
    frames = tree()
    frames.put("cup", "table", 0, at(), static=True)
    with pytest.raises(NotConnected):
        frames.lookup("map", "cup")


def test_a_ring_is_an_error_and_not_a_hang() -> None:
    frames = Frames(10)
    frames.put("a", "b", S, at(), static=False)
    frames.put("b", "a", S, at(), static=False)
    with pytest.raises(NotConnected):
        frames.lookup("a", "b")


def test_what_is_no_transform_is_left_out() -> None:
    frames = Frames(10)
    frames.put("a", "a", S, at(), static=False)
    frames.put("a", "", S, at(), static=False)
    frames.put("a", "b", S, Place(math.nan, 0, 0, 0, 0, 0, 1), static=False)
    frames.put("a", "b", S, Place(0, 0, 0, 0, 0, 0, 0), static=False)
    assert frames.tree() == {}


def test_old_times_are_forgotten_and_what_is_static_is_not() -> None:
    frames = tree(buffer=2)
    for tenth in range(1050, 1300):
        frames.put("base_link", "odom", tenth * S // 10, at(tenth / 10), static=False)
    with pytest.raises(Extrapolation):
        frames.lookup("odom", "base_link", 120 * S)
    assert len(frames._tracks["base_link"].times) < 40  # noqa: SLF001 - a bound of memory
    assert near(frames.lookup("map", "odom")[0], at(1, 0, 0, math.pi / 2))


def test_times_that_come_in_any_order_are_sorted() -> None:
    frames = Frames(10)
    for second in (3, 1, 2, 5, 4):
        frames.put("a", "b", second * S, at(second), static=False)
    assert near(frames.lookup("b", "a", 3 * S + S // 2)[0], at(3.5))


def test_a_clock_that_was_set_back_does_not_leave_the_tree_deaf() -> None:
    frames = tree()
    for second in range(1, 5):
        frames.put("base_link", "odom", second * S, at(second), static=False)
    place, time = frames.lookup("odom", "base_link")
    assert (place, time) == (at(4), 4 * S)


def test_a_frame_hung_elsewhere_is_found_there() -> None:
    frames = tree()
    version = frames.version
    frames.put("base_link", "lift", 106 * S, at(7), static=False)
    assert frames.version > version
    assert frames.tree()["base_link"] == "lift"
    with pytest.raises(NotConnected):
        frames.lookup("map", "camera")


numbers = st.floats(-100, 100)
places = st.builds(
    lambda x, y, z, q: Place(x, y, z, *q),
    numbers,
    numbers,
    numbers,
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) >= 0.6),
)


@given(places, places, places)
def test_there_and_back_is_where_one_was(a: Place, b: Place, c: Place) -> None:
    frames = Frames(10)
    frames.put("b", "a", 0, a, static=True)
    frames.put("c", "b", S, b, static=False)
    frames.put("d", "b", 0, c, static=True)
    there, _ = frames.lookup("c", "d")
    back, _ = frames.lookup("d", "c")
    joined = Frames(10)
    joined.put("d", "c", 0, there, static=True)
    joined.put("c2", "d", 0, back, static=True)
    assert near(joined.lookup("c", "c2")[0], at())
