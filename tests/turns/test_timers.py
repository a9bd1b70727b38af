from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
import uvloop

from rcp_scheduling.timers import Timers

Loops = Callable[[], asyncio.AbstractEventLoop]
LOOPS = pytest.mark.parametrize("new_loop", [asyncio.new_event_loop, uvloop.new_event_loop])


class Still:
    """A loop whose clock stands until `go`, so that timers are set at one moment."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.call_at = loop.call_at
        moment = loop.time()
        self.time = lambda: moment
        self._loop = loop

    def go(self) -> None:
        self.time = self._loop.time


@LOOPS
@pytest.mark.parametrize("first", [0.0, 0.0001, 0.0004, 0.02])
def test_each_is_called_once_and_the_earlier_first(new_loop: Loops, first: float) -> None:
    called: list[str] = []

    async def run() -> None:
        done = asyncio.Event()
        loop: Any = Still(asyncio.get_running_loop())
        timers = Timers(loop)
        timers.later(first + 0.05, done.set)
        timers.later(first, lambda: called.append("later"))
        timers.later(first - 0.00005, lambda: called.append("earlier"))
        timers.later(first + 0.00005, lambda: called.append("last"))
        loop.go()
        await asyncio.wait_for(done.wait(), 60)
        timers.close()

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(run())
    assert called == ["earlier", "later", "last"]


@LOOPS
def test_one_that_raises_does_not_silence_the_others(new_loop: Loops) -> None:
    async def run() -> None:
        done = asyncio.Event()
        loop = asyncio.get_running_loop()
        received: list[object] = []
        loop.set_exception_handler(lambda _, context: received.append(context["exception"]))
        timers = Timers(loop)
        timers.later(0.0, lambda: 1 / 0)
        timers.later(0.0001, done.set)
        await asyncio.wait_for(done.wait(), 60)
        assert [type(error) for error in received] == [ZeroDivisionError]

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(run())
