"""Writes and services with an idempotency key: the first outcome is kept, and answers each repetition."""

from __future__ import annotations

import asyncio
from copy import copy

from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.wire import Reply, Request
from rcp_requests.idempotency import Keys
from rcp_requests.inflight import InFlight

__all__ = ["KeyedWrites"]


class KeyedWrites:
    """Notes writes under their keys; `place` is the path that a key belongs to."""

    def __init__(self, keys: Keys, inflight: InFlight, loop: asyncio.AbstractEventLoop) -> None:
        self._keys = keys
        self._inflight = inflight
        self._loop = loop

    def find(self, session: Session, request: Request, place: str) -> asyncio.Future[Reply] | None:
        """Return the outcome of the first write with the request's key, or None.

        :raises DuplicateRequest: the key was used for a different request.
        """
        first = self._keys.find(session, request, place)
        return first if isinstance(first, asyncio.Future) else None

    def note(self, session: Session, request: Request, place: str, answer: Answer) -> Answer:
        """Store a write under its key; return the receiver of its reply."""
        outcome: asyncio.Future[Reply] = self._loop.create_future()
        self._keys.note(session, request, place, outcome)

        def noted(reply: Reply) -> None:
            outcome.set_result(reply)
            self._keys.settle(session, request, place, reply)
            answer(reply)

        return noted

    def note_service(
        self, session: Session, request: Request, place: str, answer: Answer
    ) -> Answer:
        """Store an execute of a service under its key; return the receiver of its reply.

        One that fails may be repeated.
        """
        if request.idempotency_key is None:
            return answer
        outcome: asyncio.Future[Reply] = self._loop.create_future()
        self._keys.note(session, request, place, outcome)

        def noted(reply: Reply) -> None:
            outcome.set_result(reply)
            if reply.error is None:
                self._keys.settle(session, request, place, reply)
            else:
                self._keys.forget(session, request, place)
            answer(reply)

        return noted

    def repeat(
        self,
        first: asyncio.Future[Reply],
        session: Session,
        request: Request,
        path: str | None,
        timeout: float,
        answer: Answer,
    ) -> None:
        """Answer a repetition with the outcome of the first write."""

        def again(done: Reply) -> Reply:
            reply = copy(done)
            reply.id = request.id
            return reply

        self._inflight.answer_later(session, request, answer, _outcome(first), again, timeout, path)

    def forget(self, session: Session, request: Request, place: str) -> None:
        """Let the key go: the write was refused before it could have done anything."""
        self._keys.forget(session, request, place)

    async def committed(self) -> None:
        """Wait until the keys noted so far are kept."""
        await self._keys.committed()


async def _outcome(first: asyncio.Future[Reply]) -> Reply:
    return await asyncio.shield(first)
