"""When the guard stops the robots and when it lets go, by a clock that a test sets."""

from __future__ import annotations

from rcp_guard.watch import Watch

AFTER, BOUND = 0.5, 10.0


def beating(watch: Watch, start: float, seconds: float) -> float:
    """Have heartbeats come in time for a while; return when the last one came."""
    now = start
    while now < start + seconds:
        watch.hear(now)
        watch.judge(now)
        now += 0.1
    return now - 0.1


def armed() -> Watch:
    watch = Watch(AFTER, BOUND, 0.0)
    watch.hear(0.0, ["cart"])
    return watch


def test_heartbeats_in_time_stop_nothing() -> None:
    watch = armed()
    beating(watch, 0.0, 60.0)
    assert not watch.stopping


def test_it_stops_what_is_armed_only_after_the_time() -> None:
    watch = armed()
    wait = watch.judge(0.5)
    assert not watch.stopping
    assert 0 < wait < 0.01  # and looks again when it is due
    watch.judge(0.502)
    assert watch.stopping == {"cart"}


def test_what_is_not_armed_is_left_alone() -> None:
    watch = Watch(AFTER, BOUND, 0.0)
    watch.judge(100.0)
    assert not watch.stopping
    watch.lose(100.0)
    watch.judge(100.0)
    assert (watch.stopping, watch.over) == (frozenset(), True)


def test_three_heartbeats_in_time_end_the_stops() -> None:
    watch = armed()
    watch.judge(2.0)
    for moment in (2.0, 3.0, 3.1):  # after the freeze, late again, in time
        watch.hear(moment)
        watch.judge(moment)
        assert watch.stopping
    for moment in (3.2, 3.3):
        watch.hear(moment)
        watch.judge(moment)
    assert not watch.stopping


def test_the_bound_ends_the_stops_until_the_loop_has_turned_once_more() -> None:
    watch = armed()
    watch.judge(1.0)
    watch.judge(11.0)
    assert not watch.stopping
    watch.judge(20.0)
    assert not watch.stopping
    watch.hear(21.0)
    watch.judge(22.0)
    assert watch.stopping


def test_the_end_of_the_gateway_stops_at_once_and_the_guard_ends_after_the_bound() -> None:
    watch = armed()
    watch.lose(0.1)
    watch.judge(0.1)
    assert (watch.stopping, watch.over) == ({"cart"}, False)
    watch.judge(10.2)
    assert (watch.stopping, watch.over) == (frozenset(), True)


def test_a_gateway_that_dies_while_frozen_does_not_begin_the_bound_anew() -> None:
    watch = armed()
    watch.judge(1.0)
    watch.lose(6.0)
    watch.judge(10.9)
    assert watch.stopping
    watch.judge(11.0)
    assert watch.over


def test_one_that_dies_after_the_bound_is_not_stopped_once_more() -> None:
    watch = armed()
    watch.judge(1.0)
    watch.judge(11.0)
    watch.lose(30.0)
    watch.judge(30.0)
    assert watch.over


def test_told_to_end_it_stops_for_a_second_more() -> None:
    watch = armed()
    watch.end()
    watch.judge(0.1)
    assert not watch.over  # the gateway lives
    watch.lose(0.2)
    watch.judge(0.3)
    assert watch.stopping
    watch.judge(1.21)
    assert watch.over
