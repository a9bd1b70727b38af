"""Requests in flight: those answered later, each in one of its session's slots."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from time import perf_counter
from typing import Any

from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.pending import Pending, to_internal_error
from rcp_kernel.contract.turns import Turns
from rcp_kernel.errors import DuplicateRequest, QueueFull, RcpError
from rcp_kernel.sessions.counts import RequestCounts
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Reply, Request, failure

__all__ = ["InFlight"]


class InFlight:
    """Keeps the places, and answers when the work is done."""

    def __init__(
        self,
        settings: Settings,
        counts: RequestCounts,
        turns: Turns,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._settings = settings
        self._counts = counts
        self._turns = turns
        self._loop = loop

    def later(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        work: Any,
        make: Callable[[Any], Reply],
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
        started = perf_counter()
        try:
            key = f"\0{secrets.token_hex(8)}" if urgent else self.claim(session, request)
        except RcpError:
            work.close()
            raise

        def settle(result: Any, error: RcpError | None) -> None:
            session.inflight.pop(key, None)
            try:
                reply = make(result) if error is None else None
            except Exception as trouble:
                reply, error = None, to_internal_error(trouble, path=path)
            if reply is None:
                assert error is not None
                reply = failure(error, request.type, request.id, path)
            reply.custom = request.custom
            self._counts.conclude(session, reply, started)
            answer(reply)

        pending = session.inflight[key] = Pending(self._loop, work, timeout, settle, path)
        if urgent:
            pending.start()
        else:
            self._turns.begin(session.principal.identity, pending.start)

    def claim(self, session: Session, request: Request) -> str:
        """Reserve a place among the session's unanswered requests.

        :raises DuplicateRequest: the id is in use.
        :raises QueueFull: there is no place left.
        """
        key = self.place(session, request)
        session.inflight[key] = None
        return key

    def place(self, session: Session, request: Request) -> str:
        """Return the place that a request would have, and reserve none.

        :raises DuplicateRequest, QueueFull: as `claim` does.
        """
        inflight = session.inflight
        if len(inflight) >= self._settings.limits.in_flight:
            raise QueueFull(f"this session already has {len(inflight)} unanswered requests")
        if request.id is None or session.stateless:
            return f"\0{secrets.token_hex(8)}"
        if request.id in inflight:
            raise DuplicateRequest(f"a request with the id '{request.id}' is still unanswered")
        return request.id

    def deadline(self, request: Request, entry: Entry) -> float:
        """Return the seconds a read or write may take."""
        own = entry.resource.timeout or self._settings.limits.deadline
        return min(own, request.deadline) if request.deadline is not None else own
