"""A bound on time that is broken once is tried again; anything else that fails is not."""

from __future__ import annotations

from typing import NoReturn

import pytest

from timing import in_one_of_three_attempts, in_time

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
