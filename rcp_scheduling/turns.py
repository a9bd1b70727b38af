"""Who may use the event loop when: what is dear runs in steps, and never many in one turn.

Everything of the gateway runs on one loop, e-stops and dead-man timers too. Between two looks of the
loop at its sockets, all dear work together has a few milliseconds; who sent it has its share in
turns with the others. What brings a robot to rest never waits here.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Generator, Hashable
from contextlib import contextmanager
from contextvars import Context, copy_context
from functools import partial
from time import thread_time
from typing import NamedTuple, TypeVar

import structlog

from rcp_protocol.errors import QueueFull

__all__ = ["Turns", "Work", "at_once"]

log = structlog.get_logger("rcp.gateway")
Result = TypeVar("Result")
Work = Generator[None]
"""Something dear, which yields where it may be interrupted: after a millisecond, better sooner."""

_TURN = 0.002  # s in one turn of the loop, after which the next step waits for the next turn
_LONG = 0.005  # s of one step that cannot be interrupted, after which nothing dear runs for a while
_REST = 3.0  # times as long as that step: what follows from it, and an e-stop, have the loop
_START = _TURN / 16  # s that it takes to begin something whose cost comes in a later turn
_WAITING = 1024  # works of one owner that have not ended: more than one batch makes
_BYTES = 32 * 1024 * 1024  # of the requests that they are for


def at_once(steps: Generator[None, None, Result]) -> Result:
    """Go through all steps of something where there is no turn to wait for; return its result."""
    try:
        while True:
            next(steps)
    except StopIteration as end:
        return end.value


class _Begun(NamedTuple):
    """A work's place in the queue."""

    context: Context
    work: Work
    size: int


class _Queue:
    """What one owner has waiting."""

    __slots__ = ("places", "size")

    def __init__(self) -> None:
        self.places: deque[_Begun | asyncio.Future[None]] = deque()
        self.size = 0


class Turns:
    """Shares the time of each turn out, in steps: one of each owner after the other.

    Beside what is dear there are calls, which are short: they have turns of their own, so that the
    ordinary requests of an owner do not wait for the dear ones of the same owner.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self.number = 0
        """Of the present turn: what was counted by somebody else in another one is over."""
        self._spent = 0.0
        self._resting = 0.0
        """Until when nothing dear runs, by the loop's clock."""
        self._scheduled = False
        self._queues: dict[Hashable, _Queue] = {}
        self._calls: dict[Hashable, deque[Callable[[], None]]] = {}

    @property
    def over(self) -> bool:
        """Whether the time of this turn is used up."""
        return self._spent > _TURN

    @property
    def _free(self) -> bool:
        """Whether something dear may run at once."""
        if self._queues or self._spent > _TURN:
            return False
        return not self._resting or self._loop.time() >= self._resting

    def run(self, owner: Hashable, work: Work, size: int = 0) -> None:
        """Do work: at once as far as there is time, the rest in the coming turns.

        It is for a request of `size` bytes, which are kept meanwhile.

        :raises QueueFull: too much of the same owner waits already.
        """
        begun = _Begun(copy_context(), work, size)
        if self._done_at_once(begun):
            return
        queue = self._queues.get(owner)
        if queue is not None and (
            len(queue.places) >= _WAITING or (queue.size and queue.size + size > _BYTES)
        ):
            raise QueueFull(
                f"{len(queue.places)} long requests of this client are already waiting",
                remedy="Wait for their replies before you send more.",
                retry_after=1.0,
            )
        self._append(owner, begun)

    def oblige(self, owner: Hashable, work: Work) -> None:
        """Do as `run` does, however much waits: for what follows from something that has happened."""
        begun = _Begun(copy_context(), work, 0)
        if not self._done_at_once(begun):
            self._append(owner, begun)

    def _done_at_once(self, begun: _Begun) -> bool:
        """Do what there is time for now; tell whether that was all."""
        while self._free:
            if not self._step(begun):
                return True
        return False

    def _append(self, owner: Hashable, begun: _Begun) -> None:
        queue = self._queues.get(owner) or _Queue()
        queue.places.append(begun)
        queue.size += begun.size
        self._queues[owner] = queue
        self._schedule()

    def call(self, owner: Hashable, function: Callable[[], None]) -> None:
        """Call what takes less than a millisecond, in a coming turn that has time for it."""
        calls = self._calls.get(owner)
        if calls is None:
            calls = self._calls[owner] = deque()
        calls.append(function)
        self._schedule()

    def begin(self, owner: Hashable, start: Callable[[], None]) -> None:
        """Begin something whose cost comes later: now if there is time, and in its owner's order."""
        if self._spent > _TURN or self._calls.get(owner):
            self.call(owner, partial(self._begin, start))
            return
        self._spent += _START
        if not self._scheduled:
            self._schedule()
        start()

    def _begin(self, start: Callable[[], None]) -> None:
        self._spent += _START
        start()

    async def wait(self, owner: Hashable) -> None:
        """Wait for a turn in which there is time left; say with `spending` what is used of it."""
        if not self._free:
            await self.place(owner)

    async def finish(self, owner: Hashable, work: Generator[None, None, Result]) -> Result:
        """Do work of any length in the turns that have time for it; return its result."""
        while True:
            await self.wait(owner)
            with self.spending():
                try:
                    next(work)
                except StopIteration as end:
                    return end.value

    def place(self, owner: Hashable) -> asyncio.Future[None]:
        """Return what is done as soon as there is a turn for it: one place in each turn."""
        place = self._loop.create_future()
        self._queues.setdefault(owner, _Queue()).places.append(place)
        self._schedule()
        return place

    @contextmanager
    def spending(self) -> Generator[None]:
        """Count the time while entered."""
        began = thread_time()
        try:
            yield
        finally:
            self.add(thread_time() - began)

    def add(self, seconds: float) -> None:
        """Count time; what was counted is forgotten with the loop's next turn."""
        self._spent += seconds
        self._schedule()

    def _schedule(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self._turn)

    def _turn(self) -> None:
        self._spent = 0.0
        self.number += 1
        self._scheduled = False
        while self._calls or (self._queues and not self._rests()):
            if self._calls:
                self._serve_calls()
            if self._queues and self._spent <= _TURN and not self._rests():
                self._serve_dear()
            if self._spent > _TURN:
                break
        if self._spent or self._calls or (self._queues and not self._resting):
            self._schedule()

    def _rests(self) -> bool:
        """Tell whether nothing dear runs for a while; somebody looks again at its end."""
        if self._resting and self._loop.time() >= self._resting:
            self._resting = 0.0
        return self._resting > 0.0

    def _serve_calls(self) -> None:
        """Serve calls while there is time: one of each owner after the other.

        One look at the clock, a system call, is the end of a call and the start of the next.
        """
        waiting = self._calls
        began = thread_time()
        while waiting and self._spent <= _TURN:
            owner, calls = next(iter(waiting.items()))
            function = calls.popleft()
            try:
                function()
            except Exception:
                log.exception("call_failed")
            finally:
                ended = thread_time()
                self.add(ended - began)
                began = ended
                # It stays where it is meanwhile, so that what it begins keeps its order.
                del waiting[owner]
                if calls:  # behind all others
                    waiting[owner] = calls
            if self._queues and not self._rests():
                return  # what is dear has its turns in between

    def _serve_dear(self) -> None:
        owner, queue = next(iter(self._queues.items()))
        first = queue.places.popleft()
        if isinstance(first, _Begun):
            if self._step(first):
                queue.places.appendleft(first)
            else:
                queue.size -= first.size
        elif not first.done():
            first.set_result(None)
            # What it takes is not known before the next turn: nothing more in this one.
            self._spent = 2 * _TURN
        # It stays where it is meanwhile: a step may have more work done for the same owner.
        del self._queues[owner]
        if queue.places:  # behind all others
            self._queues[owner] = queue

    def _step(self, begun: _Begun) -> bool:
        """Do one step; tell whether there are more."""
        began = thread_time()
        try:
            begun.context.run(next, begun.work)
        except StopIteration:
            return False
        except Exception:
            log.exception("work_failed")
            return False
        else:
            return True
        finally:
            took = thread_time() - began
            self.add(took)
            if took > _LONG:
                self._rest(_REST * took)

    def _rest(self, seconds: float) -> None:
        """Let nothing dear run for a while."""
        self._resting = self._loop.time() + seconds
        self._loop.call_at(self._resting, self._end_rest, self._resting)

    def _end_rest(self, until: float) -> None:
        """Have the queues served again, unless another rest has begun meanwhile.

        The clock is not asked: uvloop calls up to a millisecond early.
        """
        if self._resting == until:
            self._resting = 0.0
        self._schedule()
