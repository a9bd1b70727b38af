"""Requests that features send in the name of principals that may be absent."""

from __future__ import annotations

from rcp_kernel.access.identities import Identities
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.sessions.session import Answer, Handler, Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.wire import Request, failure

__all__ = ["Delegation"]


class Delegation:
    """Acts for principals that have requested it earlier, with the rights that they have now."""

    def __init__(self, identities: Identities, sessions: Sessions) -> None:
        self._identities = identities
        self._sessions = sessions
        self._handle: Handler = _refuse_too_early

    def set_handler(self, handle: Handler) -> None:
        """Set the handler of requests, which is created after the features."""
        self._handle = handle

    def renewed(self, principal: Principal) -> Principal | None:
        """Return a principal with its current roles; None if its credentials are no longer valid."""
        return self._identities.renewed(principal)

    def session(self, principal: Principal, tenant: str | None, transport: str) -> Session:
        """Return the session that all requests for a principal share; it cannot reset an e-stop.

        `principal` is a renewed one. `transport` names the feature in records and metrics.

        :raises Forbidden: the principal does not act in `tenant`.
        """
        session = self._sessions.stateless(principal, transport, tenant)
        session.unattended = True
        return session

    def send(self, session: Session, request: Request, answer: Answer) -> None:
        """Handle a request as if the principal's client had sent it, with all checks.

        `answer` receives every reply, exactly one of them final; possibly before this returns.
        """
        self._handle(session, request, answer)


def _refuse_too_early(_: Session, request: Request, answer: Answer) -> None:
    error = AdapterUnavailable("the gateway is starting", remedy="Try again.", retry_after=1)
    answer(failure(error, request.type))
