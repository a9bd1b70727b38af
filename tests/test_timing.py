"""A bound on time that is broken once is tried again; anything else that fails is not."""

from __future__ import annotations

import time
from typing import NoReturn

import pytest

from timing import Load, in_one_of_three_attempts, in_time, in_time_under, measured_load

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(("seconds", "attempts"), [((9, 9, 1), 3), ((1,), 1)])
async def test_one_attempt_in_time_is_enough(seconds: tuple[int, ...], attempts: int) -> None:
    took = list(seconds)

    @in_one_of_three_attempts
    async def attempt() -> None:
        in_time(took.pop(0), 2)

    await attempt()
    assert len(seconds) - len(took) == attempts


async def test_three_that_are_late_fail() -> None:
    tried: list[int] = []

    @in_one_of_three_attempts
    async def attempt() -> None:
        tried.append(1)
        in_time(2.5, 2)

    with pytest.raises(AssertionError, match=r"it took 2\.500 s, the bound is 2 s"):
        await attempt()
    assert len(tried) == 3


async def test_what_fails_for_another_reason_fails_at_once() -> None:
    tried: list[int] = []

    @in_one_of_three_attempts
    async def attempt() -> NoReturn:
        tried.append(1)
        raise AssertionError("it went the wrong way")

    with pytest.raises(AssertionError, match="the wrong way"):
        await attempt()
    assert tried == [1]


def test_a_load_adds_what_was_lost_up_to_a_limit() -> None:
    load = Load()
    for lost, bound in ((0.0, 1.0), (0.2, 1.2), (7.0, 1.3)):
        load.lost = lost
        assert load.allows(1.0, 0.3) == pytest.approx(bound)


@pytest.mark.parametrize(("lost", "attempts"), [(0.0, 1), (0.01, 1), (0.1, 3), (9.0, 3)])
async def test_what_is_late_is_tried_again_only_where_the_machine_was_busy(
    lost: float, attempts: int
) -> None:
    tried: list[int] = []
    load = Load()
    load.lost = lost

    @in_one_of_three_attempts
    async def attempt() -> None:
        tried.append(1)
        in_time_under(load, 1.4, 0.7)

    with pytest.raises(AssertionError, match=r"it took 1\.4"):
        await attempt()
    assert len(tried) == attempts


def test_the_time_lost_to_other_work_is_measured() -> None:
    until = time.monotonic() + 60.0
    with measured_load() as load:
        while not load.lost:  # a thread never wakes without any delay
            assert time.monotonic() < until
            time.sleep(0.001)  # the other thread tells nobody
