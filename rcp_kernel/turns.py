"""Who may use the event loop when: what is dear runs in steps, and never many in one turn.

Everything of the gateway runs on one loop, e-stops and dead-man timers too. Between two looks of the
loop at its sockets, all dear work together has a few milliseconds; who sent it has its share in
turns with the others. What brings a robot to rest never waits here.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Generator, Hashable
from contextlib import contextmanager
from contextvars import Context, copy_context
from time import thread_time

import structlog

from rcp_kernel.errors import QueueFull

__all__ = ["Turns", "Work"]

log = structlog.get_logger("rcp.gateway")
Work = Generator[None]
"""Something dear, which yields where it may be interrupted: after a millisecond, better sooner."""

_TURN = 0.002  # s in one turn of the loop, after which the next step waits for the next turn
_WAITING = 256  # works of one owner that have not ended


class _Wake:
    """A place in the queue of a coroutine."""

    __slots__ = ("future",)

    def __init__(self) -> None:
        self.future: asyncio.Future[None] = asyncio.get_running_loop().create_future()


class Turns:
    """Shares the time of each turn out, in steps: one of each owner after the other."""

    def __init__(self) -> None:
        self._spent = 0.0
        self._scheduled = False
        self._queues: dict[Hashable, deque[tuple[Context, Work] | _Wake]] = {}

    def run(self, owner: Hashable, work: Work) -> None:
        """Do work: at once as far as there is time, the rest in the coming turns.

        :raises QueueFull: too much of the same owner waits already.
        """
        context = copy_context()
        while not self._queues and self._spent <= _TURN:
            if not self._step(context, work):
                return
        queue = self._queues.setdefault(owner, deque())
        if len(queue) >= _WAITING:
            raise QueueFull(
                f"{len(queue)} requests of yours that take long are waiting already",
                remedy="Wait for their answers before you send more.",
                retry_after=1.0,
            )
        queue.append((context, work))
        self._schedule()

    async def wait(self, owner: Hashable) -> None:
        """Wait for a turn in which there is time left; say with `spending` what is used of it."""
        if self._spent > _TURN or self._queues:
            place = _Wake()
            self._queues.setdefault(owner, deque()).append(place)
            self._schedule()
            await place.future

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
            asyncio.get_running_loop().call_soon(self._turn)

    def _turn(self) -> None:
        self._spent = 0.0
        self._scheduled = False
        while self._queues and self._spent <= _TURN:
            owner = next(iter(self._queues))
            queue = self._queues.pop(owner)
            first = queue.popleft()
            if isinstance(first, _Wake):
                if not first.future.done():
                    first.future.set_result(None)
                    # What it takes is not known before the next turn: nothing more in this one.
                    self._spent = 2 * _TURN
            elif self._step(*first):
                queue.appendleft(first)
            if queue:  # behind all others
                self._queues[owner] = queue
        if self._spent or self._queues:
            self._schedule()

    def _step(self, context: Context, work: Work) -> bool:
        """Do one step; tell whether there are more."""
        began = thread_time()
        try:
            context.run(next, work)
        except StopIteration:
            return False
        except Exception:
            log.exception("work_failed")
            return False
        else:
            return True
        finally:
            self.add(thread_time() - began)
