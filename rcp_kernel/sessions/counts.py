"""Request statistics: number, outcome and duration."""

from __future__ import annotations

from time import perf_counter

from rcp_kernel.contract.metrics import Histogram
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import Reply

__all__ = ["RequestCounts"]


class RequestCounts:
    """Counts final replies."""

    __slots__ = ("outcomes", "seconds")

    def __init__(self) -> None:
        self.outcomes: dict[tuple[str, str, str], int] = {}
        """Requests by transport, type and code."""
        self.seconds = Histogram()

    def conclude(self, session: Session, reply: Reply, started: float) -> None:
        """Count a final reply."""
        self.seconds.observe(perf_counter() - started)
        error = reply.error
        key = (session.transport, reply.type, "ok" if error is None else error["code"])
        try:
            self.outcomes[key] += 1
        except KeyError:
            self.outcomes[key] = 1

    def count(self, transport: str, type_: str, code: str) -> None:
        """Count one request by its outcome."""
        key = (transport, type_, code)
        self.outcomes[key] = self.outcomes.get(key, 0) + 1
