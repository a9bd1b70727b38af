"""Requests of a feature in the name of somebody who may be absent."""

from __future__ import annotations

from typing import Protocol

from rcp_kernel.contract.identity import Principal
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.wire import Request

__all__ = ["Delegation"]


class Delegation(Protocol):
    """Acts for principals that have asked for it before, with the rights that they have now."""

    def renewed(self, principal: Principal) -> Principal | None:
        """Return a principal with its current roles; None if its credentials are no longer valid."""
        ...

    def session(self, principal: Principal, tenant: str | None, transport: str) -> Session:
        """Return the session that all requests for a principal share; it cannot reset an e-stop.

        `principal` is a renewed one. `transport` names the feature in records and metrics.

        :raises Forbidden: the principal does not act in `tenant`.
        """
        ...

    def send(self, session: Session, request: Request, answer: Answer) -> None:
        """Handle a request as if the principal's client had sent it, with all checks.

        `answer` receives every reply, exactly one of them final; possibly before this returns.
        """
        ...
