"""A bound on time that is broken once is tried again; anything else that fails is not."""

from __future__ import annotations

import time
from typing import NoReturn

import pytest

from timing import Load, in_one_of_three_attempts, in_time, measured_load

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


def test_a_load_is_how_much_longer_the_slowest_work_took() -> None:
    load = Load()
    assert load.worst == 1.0
    for took in (0.002, 0.012, 0.004):
        load.note(took, 0.004)
    assert load.worst == pytest.approx(3.0)
    assert load.allows(1.0, 0.5) == pytest.approx(2.0)


def test_the_machines_own_load_is_measured() -> None:
    until = time.monotonic() + 60.0
    with measured_load() as load:
        while load.worst == 1.0:  # it is never exactly that
            assert time.monotonic() < until
            time.sleep(0.001)  # the other thread tells nobody
    assert load.worst > 1.0
