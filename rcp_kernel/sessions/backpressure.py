"""Data queued for a slow client, and how it is reduced.

Samples are counted on demand, never with each update: a queue is estimated as its length times the
size of its path's newest sample. Data accepted by the operating system is not counted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Container
from operator import itemgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rcp_kernel.sessions.outbound import Outbound
    from rcp_kernel.sessions.outbox import Outbox
    from rcp_kernel.sessions.session import Session

__all__ = ["Relief", "shed", "waiting_bytes"]

_SWEEP = 0.25  # s between two checks of queued data
_SLOW = "ended: this client has more unread bytes than `limits.queue_bytes` allows"


def waiting_bytes(session: Session) -> int:
    """Return about how many bytes wait for a session's client."""
    if session.connection is None:
        return session.missed_bytes
    pending = session.connection.outbox.pending
    return session.waiting_bytes + sum(feed.queued_bytes() for feed in pending)


def shed(session: Session, reason: str) -> int:
    """Drop data where that is allowed; return the bytes still queued.

    Best effort conflates, a reliable subscription ends with `overrun` for the `reason`. Replies to
    a disconnected client are dropped and the loss is reported; those to a connected one stay.
    """
    if session.connection is None:
        while session.missed:
            session.drop_oldest()
        return 0
    _conflate(session.connection.outbox, session.subscriptions, reason)
    return waiting_bytes(session)


def _conflate(outbox: Outbox, known: Container[str], reason: str) -> None:
    for feed in list(outbox.pending):
        feed.shed(known, reason)


class Relief:
    """Drops samples queued for slow clients beyond the limit.

    The newest sample of a path is not counted: it is in memory in any case.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sessions: Callable[[], Collection[Session]],
        outbound: Outbound,
    ) -> None:
        self._loop = loop
        self._sessions = sessions
        self._outbound = outbound
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Check queued data periodically while there are sessions."""
        if self._timer is None:
            self._timer = self._loop.call_later(_SWEEP, self._poll)

    def _poll(self) -> None:
        sessions = self._sessions()
        self._timer = self._loop.call_later(_SWEEP, self._poll) if sessions else None
        held: list[tuple[int, Session]] = []
        for session in sessions:
            connection = session.connection
            if connection is not None and connection.outbox.pending:
                size = sum(
                    feed.queued_bytes() for feed in connection.outbox.pending if feed.depth > 1
                )
                if size:
                    held.append((size, session))
        total = sum(size for size, _ in held)
        for size, session in sorted(held, key=itemgetter(0), reverse=True):
            if size <= self._outbound.each and total <= self._outbound.limit:
                return
            total -= size
            assert session.connection is not None
            _conflate(session.connection.outbox, session.subscriptions, _SLOW)

    def close(self) -> None:
        """Stop checking."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
