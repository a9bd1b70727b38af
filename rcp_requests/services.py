"""`execute` of what the gateway itself does at once: the e-stop, and the services of its features.

No command is made of it, and no guard is called.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from copy import copy
from functools import partial
from inspect import iscoroutine
from time import perf_counter
from typing import Any, Protocol

from rcp_kernel.clock import iso, now
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import RcpError
from rcp_kernel.features import Service
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Reply, Request
from rcp_requests.inflight import InFlight
from rcp_requests.keyed_write import KeyedWrites
from rcp_requests.replies import ReplyGate
from rcp_requests.write import dry_run_reply

__all__ = ["EstopLane", "ServiceHandler"]


class EstopLane(Protocol):
    """The e-stop, which bypasses every queue and limit."""

    def names(self, session: Session, value: Any, /) -> list[str]:
        """Check an e-stop without executing it; return the names of the robots in its scope."""
        ...

    def request(self, session: Session, value: Any, sent: Request, /) -> Coroutine[Any, Any, Any]:
        """Latch immediately; awaiting the result waits for the robots."""
        ...


class ServiceHandler:
    """The handler of `execute` at the paths of the gateway's services."""

    def __init__(
        self,
        services: Mapping[str, Service],
        estop: EstopLane,
        *,
        inflight: InFlight,
        keyed: KeyedWrites,
        replies: ReplyGate,
        counts: RequestCounts,
    ) -> None:
        self._services = services
        self._estop = estop
        self._inflight = inflight
        self._keyed = keyed
        self._replies = replies
        self._counts = counts
        self.paths = frozenset((ESTOP, *services))
        """The paths that it handles."""

    def execute(
        self, session: Session, request: Request, entry: Entry, value: Any, answer: Answer
    ) -> Reply | None:
        """Handle an `execute` whose path is among `paths`."""
        if entry.path == ESTOP:
            return self._stop(session, request, entry, value, answer)
        self._serve(self._services[entry.path], session, request, entry, value, answer)
        return None

    def _stop(
        self, session: Session, request: Request, entry: Entry, value: Any, answer: Answer
    ) -> Reply | None:
        """Latch an e-stop or reset it; the reply is sent when the robots are confirmed at rest."""
        scope = value or entry.input_type.convert({})
        if request.dry_run:
            robots = self._estop.names(session, scope)
            return dry_run_reply(request, entry, {"execute": value, "robots": robots})

        def done(state: Any) -> Reply:
            text = "E-stop latched." if state.active else "E-stop released."
            now_ = iso(now())
            return Reply(
                type="execute",
                id=request.id,
                path=entry.path,
                body=state,
                message=text,
                timestamp=now_,
            )

        work = self._estop.request(session, scope, request)
        self._inflight.answer_later(
            session,
            request,
            self._replies.estop_when_stored(answer),
            work,
            done,
            entry.resource.timeout or 6.0,
            entry.path,
            urgent=True,
        )
        return None

    def _serve(
        self,
        service: Service,
        session: Session,
        request: Request,
        entry: Entry,
        value: Any,
        answer: Answer,
    ) -> None:
        """Execute a service of the gateway; the reply is sent once it is stored.

        A repetition with the same key is not executed.
        """
        started, limit = perf_counter(), self._inflight.deadline(request, entry)
        answer = self._replies.when_stored(answer, request)
        known = self._keyed.find(session, request, entry.path)
        if known is not None and not known.done():
            self._keyed.repeat(known, session, request, entry.path, limit, answer)
            return
        if known is not None:
            reply = copy(known.result())
            reply.id = request.id
        else:
            lost = self._replies.lost
            body = service(session, value, dry_run=request.dry_run)
            made = partial(self._service_reply, request, entry, lost)
            if iscoroutine(body):
                self._serve_later(session, request, entry, body, made, limit, answer)
                return
            if request.dry_run:
                reply = dry_run_reply(request, entry, {"execute": value})
            else:
                reply = made(body)
                self._keyed.note_service(session, request, entry.path, _ignore)(reply)
        self._counts.conclude(session.transport, reply, started)
        answer(reply)

    def _serve_later(
        self,
        session: Session,
        request: Request,
        entry: Entry,
        work: Coroutine[Any, Any, Any],
        made: Callable[[Any], Reply],
        limit: float,
        answer: Answer,
    ) -> None:
        noted = self._keyed.note_service(session, request, entry.path, answer)
        try:
            self._inflight.answer_later(session, request, noted, work, made, limit, entry.path)
        except RcpError:
            self._keyed.forget(session, request, entry.path)
            raise

    def _service_reply(self, request: Request, entry: Entry, lost: int, body: Any) -> Reply:
        reply = Reply(
            type="execute",
            id=request.id,
            path=entry.path,
            body=body,
            message=f"{entry.path} done.",
            timestamp=iso(now()),
            custom=request.custom,
        )
        return self._replies.confirmed(reply, lost)


def _ignore(_: Reply) -> None:
    """Answer nobody."""
