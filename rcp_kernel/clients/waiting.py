"""What waits for one client that takes slower than it is sent, and how that is made less.

Bytes are counted when somebody looks, never with each update: a queue weighs as many times its
path's newest sample as it holds samples, and what the operating system took already is not counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcp_kernel.errors import RcpError

if TYPE_CHECKING:
    from rcp_kernel.access.meter import Account
    from rcp_kernel.clients.session import Session
    from rcp_kernel.streaming.feeds import Feed

__all__ = ["shed", "waiting_bytes"]


def waiting_bytes(session: Session) -> int:
    """Return about how many bytes wait for a session's client."""
    if session.connection is None:
        return session.missed_bytes
    mailbox = session.connection.mailbox
    return sum(map(len, mailbox.control)) + sum(_weight(feed) for feed in mailbox.pending)


def _weight(feed: Feed) -> int:
    latest, waiting = feed.entry.latest, feed.waiting
    if latest is None or not waiting:
        return 0
    tails = latest.tails
    if tails:
        return waiting * max(map(len, tails.values()))
    try:
        return waiting * latest.weight()
    except RcpError:
        return 0


def shed(session: Session, account: Account) -> int:
    """Let go of what may be let go of; return what still waits.

    Best effort conflates, a reliable subscription ends with `overrun`, replies for a client that is
    away are lost and their loss is told; those for one that is there stay.
    """
    if session.connection is None:
        while session.missed:
            session.lose()
        return 0
    reason = (
        f"ended: more than the {account.quota.queue_bytes} bytes of the quota of this "
        f"{account.owner} wait for its clients"
    )
    for feed in list(session.connection.mailbox.pending):
        if not feed.reliable:
            feed.conflate()
        elif feed.waiting > 1 and feed.subscription.id in session.subscriptions:
            feed.subscription.overrun(feed, reason)
            for other in feed.subscription.feeds.values():
                other.conflate()
    return waiting_bytes(session)
