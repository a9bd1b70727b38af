"""The sessions of the gateway, as features see them."""

from __future__ import annotations

from typing import Any, Protocol

from rcp_kernel.sessions.session import Session

__all__ = ["SessionDirectory"]


class SessionDirectory(Protocol):
    """The directory of sessions.

    What a session holds is stored under the key `Session.holder`: the session itself, or for
    requests without a connection their principal. `Session.holders` are all keys that apply to it.
    """

    def everyone(self) -> list[Session]:
        """List the sessions of connections, and those shared by other requests."""
        ...

    def holding(self, key: str) -> list[Session]:
        """List the sessions that act for a holder."""
        ...

    def commanding(self, session: Session) -> Session:
        """Return the session by which a client commands: another one, if this one only listens."""
        ...

    def end(self, session: Session, reason: str) -> None:
        """End a connected session, with all that it holds; its client may connect again.

        `reason` completes the error `token_expired` that the client receives.
        """
        ...

    def tell(self, key: str, code: str, **facts: Any) -> None:
        """Send a notice to all sessions of a holder; disconnected ones receive it on resume."""
        ...
