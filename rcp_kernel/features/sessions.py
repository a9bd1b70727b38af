"""Who is there: sessions as features see them."""

from __future__ import annotations

from typing import Any, Protocol

from rcp_kernel.sessions.session import Session

__all__ = ["SessionDirectory"]


class SessionDirectory(Protocol):
    """The sessions of the gateway.

    What a session holds is held under a key, `Session.holder`: the session itself, or for requests
    without a connection their principal as a whole. `Session.holders` are all keys that count for it.
    """

    def everyone(self) -> list[Session]:
        """List the sessions of connections, and those that requests without one share."""
        ...

    def holding(self, key: str) -> list[Session]:
        """List the sessions that act for a holder."""
        ...

    def commanding(self, session: Session) -> Session:
        """Return the session that a client commands by: another one, if this one only listens."""
        ...

    def tell(self, key: str, code: str, **facts: Any) -> None:
        """Send a notice to all sessions of a holder; who is away gets it on return."""
        ...
