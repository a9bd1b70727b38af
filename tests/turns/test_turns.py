"""Dear work runs in steps: little in one turn of the loop, and everybody has a share."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Generator
from contextvars import ContextVar
from functools import partial

import pytest
import uvloop

from kernel.world import BOUND
from rcp_kernel.errors import QueueFull
from rcp_scheduling.turns import Turns, Work

pytestmark = pytest.mark.anyio


def busy(done: list[str], name: str, steps: int = 10, seconds: float = 0.001) -> Work:
    """Use the processor in steps."""
    for _ in range(steps):
        until = time.thread_time() + seconds
        while time.thread_time() < until:
            pass
        yield
    done.append(name)


async def until_there_are(done: list[str], count: int) -> int:
    """Return how many turns of the loop it took."""
    turns = 0
    async with asyncio.timeout(BOUND):
        while len(done) < count:
            turns += 1
            await asyncio.sleep(0)
    return turns


async def test_others_have_their_turn_between_the_steps_of_what_is_dear() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    turns.run("one", busy(done, "dear", steps=60))
    assert await until_there_are(done, 1) >= 15  # of at most three steps each


async def test_what_costs_next_to_nothing_is_done_at_once() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    turns.run("one", busy(done, "cheap", seconds=0.0))
    assert done == ["cheap"]


async def test_who_sends_little_does_not_wait_for_all_of_one_who_sends_much() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    for number in range(100):
        turns.run("much", busy(done, f"much {number}"))
    turns.run("little", busy(done, "little"))
    await until_there_are(done, 4)
    assert "little" in done
    await until_there_are(done, 101)


async def test_one_has_only_so_much_waiting() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    turns.run("much", busy(done, "much"))
    for _ in range(1023):
        turns.run("much", busy(done, "much", 1, 0.0), size=1)
    with pytest.raises(QueueFull) as refused:
        turns.run("much", busy(done, "much"), size=1)
    assert refused.value.retry_after is not None
    turns.run("little", busy(done, "little"))
    await until_there_are(done, 1025)


async def test_one_has_only_so_many_bytes_waiting() -> None:
    turns, done, most = Turns(asyncio.get_running_loop()), list[str](), 16 * 1024 * 1024
    turns.run("much", busy(done, "much"), size=2 * most + 1)
    with pytest.raises(QueueFull):
        turns.run("much", busy(done, "much"), size=most)
    await until_there_are(done, 1)
    turns.run("much", busy(done, "much"), size=most)
    turns.run("much", busy(done, "much"), size=most)
    await until_there_are(done, 3)


async def test_work_may_have_more_work_done() -> None:
    def outer() -> Work:
        yield from busy(done, "outer", steps=5)
        turns.run("one", busy(done, "inner"))
        yield

    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    turns.run("one", outer())
    turns.run("two", busy(done, "other"))
    await until_there_are(done, 3)


async def test_work_that_fails_keeps_nothing_else_from_its_turn() -> None:
    def failing() -> Work:
        yield from busy(done, "before", steps=5)
        raise ZeroDivisionError

    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    turns.run("one", failing())
    turns.run("one", busy(done, "after"))
    await until_there_are(done, 2)
    assert done == ["before", "after"]


async def test_a_coroutine_waits_for_a_turn_with_time_left() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    await asyncio.wait_for(turns.wait("two"), BOUND)
    turns.run("one", busy(done, "dear", steps=50))
    await asyncio.wait_for(turns.wait("two"), BOUND)
    assert not done
    given_up = asyncio.create_task(turns.wait("two"))
    await asyncio.sleep(0)
    given_up.cancel()
    await until_there_are(done, 1)


async def test_work_keeps_the_context_of_whoever_sent_it() -> None:
    def look() -> Work:
        yield from busy([], "", steps=5)
        seen.append(who.get())

    who, seen, turns = (
        ContextVar("who", default="nobody"),
        list[str](),
        Turns(asyncio.get_running_loop()),
    )
    token = who.set("somebody")
    turns.run("one", look())
    who.reset(token)
    await until_there_are(seen, 1)
    assert seen == ["somebody"]


async def test_work_that_somebody_waits_for_goes_in_steps_too() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()

    def work() -> Generator[None, None, int]:
        yield from busy(done, "dear", steps=60)
        return len(done)

    result = asyncio.create_task(turns.finish("one", work()))
    assert await until_there_are(done, 1) >= 15
    assert await result == 1


async def test_one_place_is_given_in_a_turn_and_each_owner_has_its_share() -> None:
    turns, given = Turns(asyncio.get_running_loop()), list[str]()
    for owner in ("much", "much", "much", "little"):
        turns.place(owner).add_done_callback(lambda _, name=owner: given.append(name))
    assert await until_there_are(given, 4) >= 4
    assert given.index("little") == 1


async def test_what_begins_keeps_its_order_and_little_begins_in_one_turn() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    for number in range(100):
        turns.begin("one", partial(done.append, f"{number}"))
    assert 0 < len(done) < 50
    turns.begin("two", partial(done.append, "other"))
    assert await until_there_are(done, 101) >= 3
    assert [name for name in done if name != "other"] == [f"{number}" for number in range(100)]
    assert done.index("other") < 50


async def test_ordinary_requests_do_not_wait_for_what_is_dear_of_the_same_owner() -> None:
    turns, done = Turns(asyncio.get_running_loop()), list[str]()
    turns.run("one", busy(done, "dear", steps=100))
    turns.call("one", partial(done.append, "ordinary"))
    await until_there_are(done, 2)
    assert done == ["ordinary", "dear"]


async def test_after_a_long_step_nothing_dear_runs_for_a_while_and_everything_else_does() -> None:
    loop = asyncio.get_running_loop()
    turns, done = Turns(loop), list[str]()
    began = loop.time()
    turns.run("one", busy(done, "long", steps=1, seconds=0.02))
    turns.run("two", busy(done, "dear", steps=1, seconds=0.0))
    turns.call("two", partial(done.append, "ordinary"))
    await until_there_are(done, 1)
    assert done == ["ordinary"]
    await until_there_are(done, 3)
    assert loop.time() - began >= 0.06
    await asyncio.wait_for(turns.wait("two"), BOUND)


@pytest.mark.parametrize("new_loop", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_what_waits_for_the_end_of_a_rest_goes_on_then_whatever_the_loop_makes_of_the_time(
    new_loop: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    """uvloop counts in whole milliseconds and may call before the time that it was given."""

    async def alone() -> None:
        loop = asyncio.get_running_loop()
        turns = Turns(loop)
        for number in range(20):
            ended = loop.create_future()
            turns.run("one", busy_then(ended, 0.0052 + number * 0.00007))
            async with asyncio.timeout(BOUND):
                await ended

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(alone())


def busy_then(ended: asyncio.Future[None], seconds: float) -> Work:
    """Use the processor for one long step, and end in the next."""
    yield from busy([], "long", steps=1, seconds=seconds)
    ended.set_result(None)
