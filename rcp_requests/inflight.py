"""Requests in flight: those answered later, each in one of its session's slots."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from inspect import CORO_CREATED, getcoroutinestate
from time import perf_counter
from typing import Any

from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.caller import request_context
from rcp_kernel.contract.fence import end_permit
from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.errors import Cancelled, DeadlineExceeded, RcpError
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Reply, Request, failure
from rcp_scheduling.timers import Deadlines
from rcp_scheduling.turns import Turns

__all__ = ["InFlight"]

Make = Callable[[Any], Reply]
"""Makes the reply from the result of the work."""


class InFlight:
    """Reserves a place for each request, and answers it when its work is done."""

    def __init__(
        self,
        settings: Settings,
        counts: RequestCounts,
        turns: Turns,
        deadlines: Deadlines,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._settings = settings
        self.counts = counts
        self._turns = turns
        self.deadlines = deadlines
        self.loop = loop

    def answer_later(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        work: Coroutine[Any, Any, Any],
        make: Make,
        timeout: float,
        path: str | None,
        *,
        urgent: bool = False,
    ) -> None:
        """Answer a request when `work` is done, or its deadline passes.

        An urgent one (the e-stop) is past every limit.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        try:
            key = (
                f"\0{secrets.token_hex(8)}"
                if urgent
                else session.in_flight_key(request, self._settings.limits.in_flight)
            )
        except RcpError:
            work.close()
            raise
        session.inflight.add(key)
        pending = _Pending(self, session, request, answer, work, make, timeout, path, key)
        if urgent:
            pending.start()
        else:
            self._turns.begin(session.principal.identity, pending.start)

    def deadline(self, request: Request, entry: Entry) -> float:
        """Return the seconds a read or write may take."""
        own = entry.resource.timeout or self._settings.limits.deadline
        return min(own, request.deadline) if request.deadline is not None else own


class _Pending:
    """One request: its coroutine, its deadline, and exactly one final reply.

    The deadline counts from now on; the coroutine runs from `start` on.
    """

    __slots__ = (
        "_answer",
        "_inflight",
        "_key",
        "_make",
        "_path",
        "_request",
        "_session",
        "_slot",
        "_started",
        "_task",
        "_timeout",
        "_work",
    )

    def __init__(
        self,
        inflight: InFlight,
        session: Session,
        request: Request,
        answer: Answer,
        work: Coroutine[Any, Any, Any],
        make: Make,
        timeout: float,
        path: str | None,
        key: str,
    ) -> None:
        self._started = perf_counter()
        self._inflight = inflight
        self._session = session
        self._request = request
        self._answer: Answer | None = answer
        self._work = work
        self._make = make
        self._timeout = timeout
        self._path = path
        self._key = key
        self._task: asyncio.Task[None] | None = None
        self._slot = inflight.deadlines.set(timeout, self, self._expire)

    def start(self) -> None:
        """Run the coroutine, unless the deadline has passed."""
        if self._answer is None:
            self._work.close()
        else:
            self._task = self._inflight.loop.create_task(self._run())

    async def _run(self) -> None:
        request_context.set((self._session.principal, self._request, self._slot, None))
        try:
            result = await self._work
        except asyncio.CancelledError:
            self._finish(None, Cancelled("the request was cancelled", path=self._path))
            raise
        except Exception as error:
            self._finish(None, to_internal_error(error, path=self._path))
        else:
            self._finish(result, None)

    def _expire(self) -> None:
        text = f"no answer from {self._path or 'the gateway'} within {self._timeout:g} s"
        self._finish(None, DeadlineExceeded(text, path=self._path))
        if self._task is not None:
            self._task.cancel()
            if getcoroutinestate(self._work) == CORO_CREATED:
                self._work.close()  # the task ends before its first step and never awaits it

    def _finish(self, result: Any, error: RcpError | None) -> None:
        answer, self._answer = self._answer, None
        if answer is None:
            return
        end_permit()  # what follows from the reply is not the robot's any more
        inflight, session, request = self._inflight, self._session, self._request
        inflight.deadlines.clear(self._slot, self)
        session.inflight.discard(self._key)
        reply = None
        if error is None:
            try:
                reply = self._make(result)
            except Exception as trouble:
                error = to_internal_error(trouble, path=self._path)
        if reply is None:
            assert error is not None
            reply = failure(error, request.type, request.id, self._path)
        reply.custom = request.custom
        inflight.counts.conclude(session.transport, reply, self._started)
        answer(reply)
