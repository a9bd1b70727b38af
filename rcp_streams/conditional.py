"""Subscriptions whose right depends on a condition: they pause while it is false."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcp_kernel.model import Operation
from rcp_kernel.sessions.notices import notice
from rcp_kernel.tree.entry import Entry
from rcp_streams.hub import Hub
from rcp_streams.path_subscription import PathSubscription

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Session

__all__ = ["ConditionalSubscriptions"]

_PERIOD = 1.0  # s between looks at the conditions


class ConditionalSubscriptions:
    """The conditional path subscriptions, checked periodically while there are any."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._feeds: dict[PathSubscription, Session] = {}
        self._waits = False

    def place(self, session: Session, feed: PathSubscription) -> None:
        """Register a new or changed path subscription; pause it if its condition is false."""
        if session.rights.depends(feed.entry, Operation.SUBSCRIBE):
            self._feeds[feed] = session
            if not self._waits:
                self._waits = True
                self._hub.later(_PERIOD, self._poll)
        else:
            self._feeds.pop(feed, None)
        self._settle(session, feed)

    def _poll(self) -> None:
        for feed, session in list(self._feeds.items()):
            if feed.subscription.feeds.get(feed.entry.path) is not feed:
                del self._feeds[feed]
            elif session.rights.depends(feed.entry, Operation.SUBSCRIBE):
                self._settle(session, feed)
            # Otherwise its rights have just changed, and what follows from that is under way.
        self._waits = bool(self._feeds)
        if self._waits:
            self._hub.later(_PERIOD, self._poll)

    def _settle(self, session: Session, feed: PathSubscription) -> None:
        may = session.rights.permits(feed.entry, Operation.SUBSCRIBE)
        if may is not feed.paused:
            return
        if may:
            self._hub.unpause(feed)
            facts = {"code": "resumed", "message": "the condition of the access rule holds again"}
        else:
            self._hub.pause(feed)
            facts = {"code": "paused", **_why(session, feed.entry)}
        # After the reply to the `subscribe` that may be in progress.
        self._hub.soon(_tell, feed, facts)


def _tell(feed: PathSubscription, facts: dict[str, Any]) -> None:
    subscription = feed.subscription
    notice(subscription.outbox, id=subscription.id, path=feed.entry.path, **facts)


def _why(session: Session, entry: Entry) -> dict[str, Any]:
    blocking = session.rights.blocking_condition(entry, Operation.SUBSCRIBE)
    if blocking is None or not session.rights.shows(blocking, entry):
        return {"message": "an access rule does not allow it at the moment"}
    return {
        "message": f"an access rule requires `{blocking.text}`",
        "condition": blocking.text,
    }
