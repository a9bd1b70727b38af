"""Requests that features send in the name of principals that may be absent."""

from __future__ import annotations

from rcp_kernel.access.identities import Identities
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.sessions.session import Answer, Handler, Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.wire import Request, failure

__all__ = ["GatewayDelegation"]


class GatewayDelegation:
    """The `Delegation` of all features."""

    def __init__(self, identities: Identities, sessions: Sessions) -> None:
        self._sessions = sessions
        self.renewed = identities.renewed
        """Returns a principal with its current roles."""
        self._handle: Handler = _too_early

    def set_handler(self, handle: Handler) -> None:
        """Set what handles requests: features are made before it."""
        self._handle = handle

    def session(self, principal: Principal, tenant: str | None, transport: str) -> Session:
        """Return the session of all requests for a principal."""
        session = self._sessions.stateless(principal, transport, tenant)
        session.unattended = True
        return session

    def send(self, session: Session, request: Request, answer: Answer) -> None:
        """Handle a request."""
        self._handle(session, request, answer)


def _too_early(_: Session, request: Request, answer: Answer) -> None:
    error = AdapterUnavailable("the gateway is starting", remedy="Try again.", retry_after=1)
    answer(failure(error, request.type))
