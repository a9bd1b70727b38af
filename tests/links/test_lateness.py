"""How late the samples of a device are, whatever its clock shows."""

from __future__ import annotations

import pytest

from rcp_links import Lateness


def test_a_sample_is_late_by_what_it_takes_longer_than_the_promptest() -> None:
    lateness = Lateness()
    assert lateness.of(-700.0, 5.0) == 0.0
    assert lateness.of(-697.0, 6.0) == pytest.approx(3.0)
    assert lateness.of(-701.0, 7.0) == 0.0


def test_the_promptest_sample_is_forgotten_after_a_while() -> None:
    lateness = Lateness()
    lateness.of(0.0, 0.0)
    assert lateness.of(2.0, 9.0) == 2.0
    assert lateness.of(2.0, 19.0) == 2.0
    assert lateness.of(2.0, 30.0) == 0.0


def test_a_clock_that_was_set_back_is_followed_from_then_on() -> None:
    lateness = Lateness(50.0)
    lateness.of(0.0, 0.0)
    assert lateness.of(49.0, 1.0) == 49.0
    assert lateness.of(90.0, 2.0) == 0.0
    assert lateness.of(91.0, 3.0) == 1.0


@pytest.mark.parametrize(("rate", "late"), [(0.5, False), (0.9999, True)])
def test_the_stamps_of_a_simulation_below_real_time_are_not_taken_for_delays(
    rate: float, *, late: bool
) -> None:
    lateness = Lateness()
    for step in range(600):
        now = step / 10
        lateness.of(now - now * rate, now)
    assert (lateness.of(60.0 - 60.0 * rate + 1.0, 60.0) > 0.0) is late
