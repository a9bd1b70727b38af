"""The connection graph: which backend publishes, takes and serves what, and what this client takes part in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from rcp_foxglove.views import View

__all__ = ["ConnectionGraph"]

Ends = dict[str, list[str]]


class ConnectionGraph:
    """The graph as one client sees it: of other clients it shows nothing."""

    def __init__(self, put: Callable[[bytes], None], name: str) -> None:
        self._put = put
        self._name = name
        self._follows = False
        self._sent: tuple[Ends, Ends, Ends] = ({}, {}, {})

    def follow(self, view: View, subscribed: set[str], published: set[str]) -> None:
        """Send the whole graph, then its changes."""
        self._follows = True
        self._sent = ({}, {}, {})
        self.renew(view, subscribed, published)

    def unfollow(self) -> None:
        """Send nothing more."""
        self._follows = False

    def renew(self, view: View, subscribed: set[str], published: set[str]) -> None:
        """Send what has changed."""
        if not self._follows:
            return
        publishers: Ends = {topic: [backend] for topic, backend in view.publishers.items()}
        subscribers: Ends = {one.topic: [one.backend] for one in view.targets.values()}
        services: Ends = {one.name: [one.backend] for one in view.services.values()}
        for topic in subscribed:
            subscribers.setdefault(topic, []).append(self._name)
        for topic in published:
            publishers.setdefault(topic, []).append(self._name)
        before, now = self._sent, (publishers, subscribers, services)
        self._sent = now
        topics_before = before[0].keys() | before[1].keys()
        topics_now = publishers.keys() | subscribers.keys()
        facts: dict[str, Any] = {
            "op": "connectionGraphUpdate",
            "publishedTopics": _changed("publisherIds", before[0], publishers),
            "subscribedTopics": _changed("subscriberIds", before[1], subscribers),
            "advertisedServices": _changed("providerIds", before[2], services),
            "removedTopics": sorted(topics_before - topics_now),
            "removedServices": sorted(before[2].keys() - services.keys()),
        }
        if any(item for key, item in facts.items() if key != "op") or not topics_before:
            self._put(msgspec.json.encode(facts))


def _changed(key: str, before: Ends, now: Ends) -> list[dict[str, Any]]:
    changed = [{"name": name, key: ends} for name, ends in now.items() if before.get(name) != ends]
    gone: list[dict[str, Any]] = [{"name": name, key: []} for name in before if name not in now]
    return changed + gone
