"""The hot path of every request: charge → resolve → admit → call.

A handler returns its reply, or None if the reply follows later; any error becomes the one final
reply of the request.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Generator
from time import perf_counter

import structlog

from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.requests import PreparedRequest
from rcp_kernel.errors import Cancelled, RcpError, UnsupportedOperation
from rcp_kernel.model import Pattern
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.wire import Reply, Request, failure
from rcp_protocol.structure import LONG, check_structure
from rcp_protocol.trace import trace_of
from rcp_requests.exempt import Exemptions
from rcp_requests.long_bodies import LongBodies
from rcp_requests.request_events import RequestEvents
from rcp_scheduling.turns import Turns

__all__ = ["RequestRouter", "Route", "SteppedRoute"]

log = structlog.get_logger("rcp.requests")

Route = Callable[[Session, Request, Answer], Reply | None]
"""Handles a request at once; returns None if the reply follows later."""

SteppedRoute = Callable[[Session, Request, Answer], Generator[None, None, Reply | None]]
"""Handles a long request in steps, between which other requests are handled.

It is called when the request arrives; the first step runs when its turn has come."""


class RequestRouter:
    """Passes each request to the handler of its type.

    It is created before the handlers, because some of them send requests themselves.
    """

    def __init__(
        self,
        settings: Settings,
        turns: Turns,
        counts: RequestCounts,
        events: RequestEvents,
        long_bodies: LongBodies,
        actions: Container[str],
        exempt: Exemptions,
    ) -> None:
        """`actions` are the paths of the gateway's long-running actions."""
        self._settings = settings
        self._turns = turns
        self._counts = counts
        self._events = events
        self._long_bodies = long_bodies
        self._actions = actions
        self._is_exempt = exempt
        self._routes: dict[str, Route] = {"hello": _hello}
        self._stepped: dict[str, SteppedRoute] = {}
        self._stopping: dict[str, Callable[[Session, Request], bool]] = {}

    def add(
        self,
        type_: str,
        route: Route | None = None,
        *,
        stepped: SteppedRoute | None = None,
        stops: Callable[[Session, Request], bool] | None = None,
    ) -> None:
        """Add the handlers of a type: `route`, and `stepped` for requests that take long.

        `stops` returns whether a request brings a robot to rest, so that no rate limit may refuse it.
        """
        if route is not None:
            self._routes[type_] = route
        if stepped is not None:
            self._stepped[type_] = stepped
        if stops is not None:
            self._stopping[type_] = stops

    def handle(self, session: Session, request: Request, answer: Answer) -> None:
        """Handle a request, which gets exactly one final reply."""
        started = perf_counter()
        try:
            account = session.account
            if account is not None and not self._is_exempt(request):
                try:
                    taken = account.take(session.monotonic())
                except Exception:  # a fault in a feature must not refuse a stop
                    log.exception("account_failed", feature=type(account).__module__)
                    taken = False
                if (
                    not taken
                    # Its items are counted individually, and one of them may be a stop.
                    and request.type != "batch"
                    and not self._stops(session, request)
                ):
                    raise account.refusal(session.monotonic())
            long = len(request.body) > LONG and self._long_bodies.takes(request)
            short = len(request.body) <= LONG and (
                request.type == "write"
                or (request.type == "execute" and (request.path or "") not in self._actions)
            )
            if (long or (not short and self._takes_long(session, request))) and not self._stops(
                session, request
            ):
                stepped = None if long else self._stepped.get(request.type)
                steps = None if stepped is None else stepped(session, request, answer)
                work = self._slowly(session, request, answer, started, steps)
                self._turns.run(session.principal.identity, work, len(bytes(request.body)))
                return
            reply = self._routes[request.type](session, request, answer)
        except Exception as error:
            reply, answer = self._refuse(session, request, answer, error)
        if reply is not None:
            self._counts.conclude(session.transport, reply, started)
            answer(reply)

    def _slowly(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        started: float,
        steps: Generator[None, None, Reply | None] | None,
    ) -> Generator[None]:
        """Handle a long request when its turn has come."""
        try:
            if session.successor is not None:
                raise Cancelled("a later `hello` replaced the session of this request")
            if len(request.body) > LONG and session.connection is None:
                limit = self._settings.limits.values
                yield from check_structure(bytes(request.body), request.encoding, limit)
            if steps is not None:
                reply = yield from steps
            else:
                request = yield from self._long_bodies.prepare(session, request)
                reply = self._routes[request.type](session, request, answer)
        except Exception as error:
            reply, answer = self._refuse(session, request, answer, error)
        if reply is not None:
            self._counts.conclude(session.transport, reply, started)
            answer(reply)

    def is_stop(self, session: Session, request: Request) -> bool:
        """Return whether a request stops or releases something, so that no feature may refuse it."""
        return self._is_exempt(request) or self._stops(session, request)

    def _stops(self, session: Session, request: Request) -> bool:
        """Return whether a request brings something to rest, so that no rate limit may refuse it."""
        stops = self._stopping.get(request.type)
        return stops is not None and stops(session, request)

    def _takes_long(self, session: Session, request: Request) -> bool:
        """Return whether a request may take longer than a fraction of a millisecond."""
        path = request.path
        prepared = isinstance(request, PreparedRequest)
        if len(request.body) > LONG and session.connection is None and not prepared:
            return True  # connections have already waited for the turn of a long message
        match request.type:
            case "discover" | "batch" | "subscribe" | "unsubscribe" | "status":
                return True
            case "read":
                return path is not None and ("*" in path or path.startswith("/system/"))
            case "execute":
                return (path or "") in self._actions
            case _:
                return False

    def _refuse(
        self, session: Session, request: Request, answer: Answer, error: Exception
    ) -> tuple[Reply, Answer]:
        """Make the reply of a refusal, in a frame outside the error's traceback.

        A frame that refers to the error would form a reference cycle for each refusal of a flood.
        """
        trace = trace_of(request.custom)
        refusal = to_internal_error(error, trace=trace, type=request.type, path=request.path)
        path = refusal.path or _full(request.path, session.tenant)
        reply = failure(refusal, request.type, request.id, path)
        reply.custom = request.custom
        hide = (request.path or "") in self._actions
        return reply, self._events.refused(session, request, reply, answer, hide=hide)


def _hello(_session: Session, _request: Request, _answer: Answer) -> Reply:
    raise UnsupportedOperation(
        "`hello` is not available over this transport",
        remedy="Send `hello` as a separate message over WebSocket; HTTP does not need it.",
    )


def _full(path: str | None, tenant: str | None) -> str | None:
    """Return the full path or pattern of a refusal; an invalid one unchanged."""
    if path is None:
        return None
    try:
        return Pattern(path, tenant).text
    except RcpError:
        return path
