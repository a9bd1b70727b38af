"""Subscriptions: their paths, options and end."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Protocol, cast

import msgspec

from rcp_conditions.filters import Where, parse_where
from rcp_kernel.errors import Overrun, RcpError
from rcp_kernel.model import Pattern
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_streams.filtered import View
from rcp_streams.frames import FrameView
from rcp_streams.options import Options
from rcp_streams.path_subscription import PathSubscription

__all__ = ["Subscription", "subscriptions_of"]


class Delivery(Protocol):
    """What a subscription needs from the object that links its paths."""

    def later(self, seconds: float, function: Callable[[], None], /) -> None:
        """Call a function in so many seconds."""
        ...

    @property
    def pattern_value(self) -> int:
        """Longest value, in bytes, sent whole to a subscription that did not name its path."""
        ...

    def soon(self, function: Callable[..., object], *args: Any) -> None:
        """Call a function in the next loop iteration."""
        ...

    def unlink(self, feed: PathSubscription) -> None:
        """Stop offering samples to a feed."""
        ...


class Links(Protocol):
    """The linker of a subscription's paths, in steps."""

    def attach(
        self, subscription: Subscription, outbox: Outbox, missed_from: dict[str, int] | None, /
    ) -> None:
        """Resume sending, missed samples first."""
        ...

    def detach(self, subscription: Subscription, /) -> None:
        """Stop sending because the connection is lost."""
        ...

    def forget(self, subscription: Subscription, /) -> None:
        """Remove a subscription whose session has ended."""
        ...


class Subscription:
    """A session's request for a stream of samples of one or more paths."""

    __slots__ = (
        "_delivery",
        "_links",
        "_named",
        "awaited",
        "end",
        "feeds",
        "framed",
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
        links: Links,
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
        framed: Callable[[Entry], FrameView | None],
        placed: Callable[[PathSubscription], None],
    ) -> None:
        self._delivery = delivery
        self._links = links
        self.id = id_
        self.patterns = patterns
        self._named = frozenset(pattern.text for pattern in patterns if pattern.literal)
        self.options = options
        self.outbox = outbox
        self.owner = owner
        """The principal in whose turns its paths are linked."""
        self.may = may
        """Whether the principal may subscribe to an entry."""
        self.end = end
        """Called with the reason when the subscription ends by itself."""
        self.view = view
        """The entry's view for this principal, if it depends on the reader."""
        self.visibility_filter = visibility_filter
        """Filters an entry's samples for this principal, if it may not see everything; None: nothing."""
        self.framed = framed
        """The entry's values in the frame of the options; None: they name none."""
        self.placed = placed
        """Called with each feed that was linked."""
        self.feeds: dict[str, PathSubscription] = {}
        self.awaited: dict[str, int] = {}
        """Paths still to be linked, in order, each with the number of its last sample when the client
        subscribed: later samples are not missed."""
        self.where: Where | None = parse_where(options.where) if options.where else None
        self.remaining = options.count
        self.skipped = 0
        """Number of samples skipped on all paths since the start: `conflated` in the metrics."""
        self.timer: Any = None

    def stored(self) -> dict[str, Any] | None:
        """Return what starts it again after a restart; None: how much of it is left is not kept."""
        options = self.options
        if options.count is not None or options.duration is not None:
            return None
        paths = [pattern.text for pattern in self.patterns]
        return {"paths": paths, "options": msgspec.to_builtins(options)}

    def attach(self, outbox: Outbox, missed_from: dict[str, int] | None) -> None:
        """Resume sending, missed samples first; `missed_from` is the client's last sample by path."""
        self._links.attach(self, outbox, missed_from)

    def detach(self) -> None:
        """Stop sending because the connection is lost; the history of its paths is still kept."""
        self._links.detach(self)

    def forget(self) -> None:
        """Let go of all its paths: its session has ended."""
        self._links.forget(self)

    def wants(self, entry: Entry) -> bool:
        """Return whether an entry belongs to this subscription."""
        return any(p.matches(entry.path) for p in self.patterns) and self.may(entry)

    def longest(self, entry: Entry) -> int | None:
        """Return the longest value of an entry that is sent whole; None: no limit."""
        return None if entry.path in self._named else self._delivery.pattern_value

    def later(self, seconds: float, function: Callable[[], None]) -> None:
        """Call a function in so many seconds."""
        self._delivery.later(seconds, function)

    def delivered(self) -> bool:
        """Count one update; return whether it was the last of a limited number."""
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
        self._delivery.unlink(feed)  # no sample of this path may follow a gap
        self._delivery.soon(self.end, self, "overrun", error)


def subscriptions_of(session: Session) -> dict[str, Subscription]:
    """Return a session's subscriptions by id: whatever subscribes puts in nothing else."""
    return cast("dict[str, Subscription]", session.subscriptions)
