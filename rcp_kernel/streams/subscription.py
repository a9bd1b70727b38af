"""Subscriptions: which samples go to whom, and what ends one that is too slow."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Protocol

from rcp_kernel.errors import Overrun, RcpError
from rcp_kernel.model import Pattern
from rcp_kernel.streams.filtered import View
from rcp_kernel.streams.filters import Options, Where, parse_where
from rcp_kernel.streams.outbox import Outbox
from rcp_kernel.streams.path_subscription import PathSubscription
from rcp_kernel.tree.entry import Entry

__all__ = ["Subscription"]


class Delivery(Protocol):
    """What a subscription needs of whoever links its paths."""

    def later(self, seconds: float, function: Callable[[], None], /) -> None:
        """Call a function in so many seconds."""
        ...

    @property
    def pattern_value(self) -> int:
        """Longest value, bytes, that is sent whole to a subscription that did not name its path."""
        ...

    def soon(self, function: Callable[..., object], *args: Any) -> None:
        """Call a function in the coming loop turn."""
        ...

    def unlink(self, feed: PathSubscription) -> None:
        """Offer a feed nothing more."""
        ...


class Subscription:
    """A standing request of one session for samples of one or more paths."""

    __slots__ = (
        "_delivery",
        "_named",
        "awaited",
        "end",
        "feeds",
        "id",
        "may",
        "options",
        "outbox",
        "owner",
        "patterns",
        "placed",
        "remaining",
        "skipped",
        "timer",
        "view",
        "visibility_filter",
        "where",
    )

    def __init__(
        self,
        delivery: Delivery,
        id_: str,
        patterns: list[Pattern],
        options: Options,
        outbox: Outbox | None,
        *,
        owner: Hashable,
        may: Callable[[Entry], bool],
        end: Callable[[Subscription, str, RcpError | None], None],
        view: Callable[[Entry], View | None],
        visibility_filter: Callable[[Entry], Callable[[Any], Any] | None],
        placed: Callable[[PathSubscription], None],
    ) -> None:
        self._delivery = delivery
        self.id = id_
        self.patterns = patterns
        self._named = frozenset(pattern.text for pattern in patterns if pattern.literal)
        self.options = options
        self.outbox = outbox
        self.owner = owner
        """In whose turns its paths are linked."""
        self.may = may
        """Whether the principal may subscribe to an entry."""
        self.end = end
        """Called when the subscription ends by itself, with the reason."""
        self.view = view
        """What an entry shows this principal, where that depends on who asks."""
        self.visibility_filter = visibility_filter
        """What of an entry's samples this principal may see, where that is not all: None is nothing."""
        self.placed = placed
        """Called with each feed that has joined."""
        self.feeds: dict[str, PathSubscription] = {}
        self.awaited: dict[str, int] = {}
        """Paths that are still to be linked, in their order, each with the number of its last
        sample when the client subscribed: what came after that is not missed."""
        self.where: Where | None = parse_where(options.where) if options.where else None
        self.remaining = options.count
        self.skipped = 0
        """Samples of all its paths that were skipped."""
        self.timer: Any = None

    def wants(self, entry: Entry) -> bool:
        """Tell whether an entry belongs to this subscription."""
        return any(p.matches(entry.path) for p in self.patterns) and self.may(entry)

    def longest(self, entry: Entry) -> int | None:
        """Return the longest value of an entry that is sent whole; None: every one is."""
        return None if entry.path in self._named else self._delivery.pattern_value

    def later(self, seconds: float, function: Callable[[], None]) -> None:
        """Call a function in so many seconds."""
        self._delivery.later(seconds, function)

    def delivered(self) -> bool:
        """Count one update; tell whether it was the last of a limited number."""
        assert self.remaining is not None
        self.remaining -= 1
        if self.remaining > 0:
            return False
        self._delivery.soon(self.end, self, "count", None)
        return True

    def overrun(self, feed: PathSubscription, why: str | None = None) -> None:
        """End the subscription: a reliable queue is full, and nothing may be skipped."""
        behind = f"fell more than {feed.depth} samples of {feed.entry.path} behind"
        error = Overrun(
            f"subscription '{self.id}' {why or behind}",
            path=feed.entry.path,
            details={"depth": feed.depth, "last_seq": feed.sent},
        )
        self._delivery.unlink(feed)  # of this path no sample may follow after a gap
        self._delivery.soon(self.end, self, "overrun", error)
