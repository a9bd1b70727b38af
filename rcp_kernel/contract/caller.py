"""The principal and request behind the current operation: a context variable.

Setting it stores a tuple; the record is made from it only for a backend that calls `caller`.
"""

from __future__ import annotations

from contextvars import ContextVar

import msgspec

from rcp_kernel.contract.identity import Principal
from rcp_kernel.wire import Request
from rcp_protocol.trace import Trace, traced
from rcp_scheduling.timers import moment_of

__all__ = ["Caller", "caller", "request_context"]


class Caller(msgspec.Struct, frozen=True):
    """The sender of the request behind an operation, and what the request says about it."""

    principal: Principal
    """As it was when the operation began; its roles in the tenant are in `grants`."""
    idempotency_key: str | None
    """The client's, whose scope is the principal."""
    deadline: float
    """When the gateway ends the operation, on the event loop's clock (`loop.time()`)."""
    command: str | None = None
    """The gateway's id of the command; None for any other operation."""
    valid_for: float | None = None
    """Seconds for which a written value is to be valid, if the client said so."""
    trace: Trace | None = None
    """The operation's place in a distributed trace, to be passed on."""

    @property
    def key(self) -> str | None:
        """The key under which the operation is passed on, so that it is done once."""
        return self.idempotency_key or self.command


request_context: ContextVar[tuple[Principal, Request, int, str | None] | None] = ContextVar(
    "rcp_request", default=None
)
"""Principal, request, slot of the deadline and command of the current operation; set by the kernel."""


def caller() -> Caller | None:
    """Return the sender of the request that the backend is carrying out.

    None for the stops and dead-man of the gateway, and for `watch`, which serves all subscribers. Valid
    until the operation ends, also while it is cancelled.
    """
    current = request_context.get()
    if current is None:
        return None
    principal, request, slot, command = current
    key, until = request.idempotency_key, moment_of(slot)
    trace = traced(request.custom, command)
    return Caller(principal, key, until, command, request.valid_for, trace)
