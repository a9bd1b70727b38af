"""Notices and skipped samples, as status messages."""

from __future__ import annotations

import asyncio
from typing import Any

from rcp_foxglove.leases import Leases
from rcp_foxglove.statuses import WARNING, Statuses
from rcp_foxglove.subscriptions import Subscriptions

__all__ = ["News"]

_PERIOD = 1.0  # s between two messages about skipped samples
_LISTED = 10
_SLOW = "slow"


class News:
    """Tells one client what it would not notice by itself."""

    def __init__(
        self,
        statuses: Statuses,
        subscriptions: Subscriptions,
        leases: Leases,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._statuses = statuses
        self._subscriptions = subscriptions
        self._leases = leases
        self._loop = loop
        self._skipped: dict[str, int] = {}
        self._timer: asyncio.TimerHandle | None = None

    def notice(self, code: str, facts: dict[str, Any]) -> None:
        """Tell a notice, if it concerns what the client does."""
        id_, text = facts.get("id", ""), facts.get("message") or code
        topic = self._subscriptions.topic_of(id_)
        if code in ("subscription_ended", "overrun"):
            self._subscriptions.lost(id_, text)
        elif code == "lease_lost":
            self._leases.lost(facts.get("lease", ""))
            why = facts.get("reason") or "it was taken over"
            by = f" by {facts['by']}" if facts.get("by") else ""
            self._statuses.tell(f"Control of {facts.get('scope')} was lost{by}: {why}.", WARNING)
        elif topic is None:
            if code == "fence_left":
                self._statuses.tell(text, WARNING)
        elif code == "paused":
            self._statuses.show(f"paused:{topic}", f"{topic}: {text}", WARNING)
        elif code == "resumed":
            self._statuses.remove(f"paused:{topic}")
        elif code == "stale":
            self._statuses.tell(f"{topic}: {text}", WARNING)

    def skipped(self, subscription: str, path: str, count: int) -> None:
        """Count samples that the client was too slow for; tell it at most once a second."""
        topic = self._subscriptions.topic_of(subscription) or path
        self._skipped[topic] = self._skipped.get(topic, 0) + count
        if self._timer is None:
            self._tell()

    def _tell(self) -> None:
        skipped, self._skipped = self._skipped, {}
        if not skipped:
            self._timer = None
            self._statuses.remove(_SLOW)
            return
        self._timer = self._loop.call_later(_PERIOD, self._tell)
        most = sorted(skipped.items(), key=lambda one: -one[1])[:_LISTED]
        text = ", ".join(f"{topic} {count}" for topic, count in most)
        more = f" and {len(skipped) - _LISTED} more topics" if len(skipped) > _LISTED else ""
        self._statuses.show(
            _SLOW,
            f"This client reads too slowly. Messages skipped: {text}{more}.",
            WARNING,
        )

    def close(self) -> None:
        """Tell nothing more."""
        if self._timer is not None:
            self._timer.cancel()
