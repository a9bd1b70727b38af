"""Calls that other threads hand over to the event loop."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextvars import Context, copy_context
from typing import Any

from rcp_gateway.containment import call_contained
from rcp_kernel.sessions.outbox import FlushScheduler

__all__ = ["ThreadCalls"]


class ThreadCalls:
    """The calls handed over for one backend; many share one wake-up of the loop."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        scheduler: FlushScheduler,
        failed: Callable[[BaseException], None],
    ) -> None:
        """`failed` is called with the exception of a call, inside its handler."""
        self._loop = loop
        self._scheduler = scheduler
        self._failed = failed
        self._calls: deque[tuple[Context, Callable[..., object], tuple[Any, ...]]] = deque()
        """Each with the context in which it was handed over."""
        self._woken = False

    def add(self, function: Callable[..., object], *args: Any) -> None:
        """Run a function on the event loop, from any thread.

        :raises RuntimeError: the loop is closed.
        """
        self._calls.append((copy_context(), function, args))
        if not self._woken:
            self._woken = True
            gather = self._scheduler.gather
            try:
                self._loop.call_soon_threadsafe(gather, self._run)
            except RuntimeError:
                self._woken = False  # so that every later caller gets the error as well
                raise

    def _run(self) -> None:
        self._woken = False  # first: what comes from now on wakes the loop again
        for _ in range(len(self._calls)):
            context, function, args = self._calls.popleft()
            context.run(self._call, function, *args)

    def _call(self, function: Callable[..., object], *args: Any) -> None:
        try:
            call_contained(function, *args)
        except (Exception, asyncio.CancelledError, GeneratorExit) as error:  # others wait behind it
            self._failed(error)
