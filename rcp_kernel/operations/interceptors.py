"""Interceptors: what wraps every request, and what becomes of a request that one of them loses.

An interceptor is a plugin's. One that raises, in a request's way in or in a reply's way out, must
not leave the client without an answer: it gets `internal` with the trace id of the log record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar

from rcp_kernel.clients.session import Answer, Handler, Session
from rcp_kernel.operations.pending import to_internal_error
from rcp_kernel.wire import FINAL, Reply, Request, failure

__all__ = ["intercepted"]


class _Exchange:
    """One request on its way through all interceptors."""

    def __init__(self, request: Request, answer: Answer) -> None:
        self._request = request
        self._answer = answer
        self._over = False

    def answer(self, reply: Reply) -> None:
        """Hand a reply to the transport; after the final one nothing more."""
        if not self._over:
            self._over = reply.status in FINAL
            self._answer(reply)

    def failed(self, error: Exception) -> None:
        """Log what an interceptor raised, and answer with it unless that was done."""
        request = self._request
        told = to_internal_error(error, type=request.type, path=request.path, by="an interceptor")
        reply = failure(told, request.type, request.id, request.path)
        reply.custom = request.custom
        self.answer(reply)


_exchange: ContextVar[_Exchange] = ContextVar("rcp_exchange")


def intercepted(wraps: Sequence[Callable[[Handler], Handler]] | None, admit: Handler) -> Handler:
    """Wrap the gateway's handler into interceptors, the first one outermost."""
    if not wraps:
        return admit

    def inner(session: Session, request: Request, answer: Answer) -> None:
        exchange = _exchange.get()

        def guarded(reply: Reply) -> None:
            try:
                answer(reply)
            except Exception as error:
                exchange.failed(error)

        admit(session, request, guarded)

    handle: Handler = inner
    for wrap in reversed(wraps):
        handle = wrap(handle)

    def outer(session: Session, request: Request, answer: Answer) -> None:
        exchange = _Exchange(request, answer)
        before = _exchange.set(exchange)
        try:
            handle(session, request, exchange.answer)
        except Exception as error:
            exchange.failed(error)
        finally:
            _exchange.reset(before)

    return outer
