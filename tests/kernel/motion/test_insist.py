"""A stop is sent until one is acknowledged, however the others fare."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import pytest
import structlog

from rcp_kernel.safety.retry import retry_until_confirmed

pytestmark = pytest.mark.anyio


@pytest.fixture(autouse=True)
def every_level() -> Iterator[None]:
    """Log everything, whatever a gateway of an earlier test was told."""
    kept = structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(0))
    yield
    structlog.configure(**kept)


BOUND = 60.0

Way = Callable[[], Coroutine[Any, Any, None]]


async def answered() -> None:
    """Take the stop."""


async def refused() -> None:
    """Say that it was not taken."""
    raise RuntimeError("not now")


class Robot:
    """Takes stops one after another as it is told to; the last way goes on for ever."""

    def __init__(self, *ways: Way) -> None:
        self.ways = list(ways)
        self.calls = 0
        self.open = 0
        self.third = asyncio.Event()
        """Set by the third call."""
        self.clear = asyncio.Event()
        """Set while no call is open."""

    async def stop(self) -> None:
        self.calls += 1
        way = self.ways[min(self.calls, len(self.ways)) - 1]
        self.open += 1
        self.clear.clear()
        if self.calls == 3:
            self.third.set()
        try:
            await way()
        finally:
            self.open -= 1
            if not self.open:
                self.clear.set()


async def lost() -> None:
    """Never answer."""
    await waited(asyncio.Event())


async def waited(event: asyncio.Event) -> None:
    """Answer when something has happened."""
    await event.wait()


async def stopped(robot: Robot) -> list[str]:
    """Insist, and return what was logged."""
    with structlog.testing.capture_logs() as records:
        async with asyncio.timeout(BOUND):
            await retry_until_confirmed(robot.stop, "stop_failed", backend="rover")
            await robot.clear.wait()
    return [record["error"] for record in records]


async def test_one_that_is_taken_is_not_repeated() -> None:
    robot = Robot(answered)
    assert await stopped(robot) == []
    assert robot.calls == 1


async def test_the_first_call_is_ahead_of_what_is_scheduled_after_it() -> None:
    robot, seen = Robot(answered), list[int]()
    stopping = retry_until_confirmed(robot.stop, "stop_failed")
    asyncio.get_running_loop().call_soon(lambda: seen.append(robot.calls))
    await stopping
    assert seen == [1]


async def test_one_that_got_lost_is_not_waited_for() -> None:
    robot = Robot(lost, answered)
    assert await stopped(robot) == []
    assert robot.calls == 2


async def test_failures_are_repeated_and_told_once_in_a_while() -> None:
    robot = Robot(refused, refused, refused, answered)
    assert await stopped(robot) == ["RuntimeError('not now')"]
    assert robot.calls == 4


async def test_a_slow_answer_to_the_first_one_counts() -> None:
    robot = Robot(lambda: waited(robot.third), refused, lost)
    assert await stopped(robot) == ["RuntimeError('not now')"]
    assert robot.calls == 3


async def test_one_that_gives_up_takes_all_its_calls_with_it() -> None:
    robot = Robot(lost)
    work = retry_until_confirmed(robot.stop, "stop_failed")
    async with asyncio.timeout(BOUND):
        await robot.third.wait()
        work.cancel()
        await asyncio.wait([work])
        await robot.clear.wait()
    assert robot.calls == 3
