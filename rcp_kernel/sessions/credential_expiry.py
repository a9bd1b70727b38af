"""Expiry of credentials: the client is warned, then its sessions are closed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from rcp_kernel.clock import Clock, iso
from rcp_kernel.sessions.notices import notice

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Session

__all__ = ["CredentialExpiry"]

_AHEAD = 30.0  # s before the expiry that the client is warned
_LOOK = 30.0  # s: clocks may be set, so the remaining time is recomputed this often


class CredentialExpiry:
    """Monitors the sessions whose credentials expire."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, clock: Clock, expel: Callable[[Session], None]
    ) -> None:
        self._clock = clock
        self._loop = loop
        self._expel = expel

    def watch(self, session: Session) -> None:
        """Monitor the expiry of a session's current principal, instead of an earlier one."""
        self.forget(session)
        if session.principal.expires is not None:
            # Not at once: the connection is created after the session.
            session.expiry_check = self._loop.call_later(0.0, self._poll, session, False)

    def forget(self, session: Session) -> None:
        """Stop monitoring a session."""
        if session.expiry_check is not None:
            session.expiry_check.cancel()
            session.expiry_check = None

    def _poll(self, session: Session, warned: bool) -> None:  # noqa: FBT001 - for `call_later`
        session.expiry_check = None
        expires = session.principal.expires
        if expires is None:
            return
        left = (expires - self._clock.now()) / 1e9
        if left <= 0:
            self._expel(session)
            return
        if left <= _AHEAD and not warned:
            warned = True
            _tell(session, expires, left)
        wait = min(left if warned else left - _AHEAD, _LOOK)
        session.expiry_check = self._loop.call_later(wait, self._poll, session, warned)


def _tell(session: Session, expires: int, left: float) -> None:
    if session.connection is not None:
        notice(
            session.connection.outbox,
            "session_expiring",
            expires=iso(expires),
            message=f"your credentials expire in {left:.0f} s",
            remedy="Send `hello` with a new token of the same principal to keep the session.",
        )
