"""Which kind of path subscription a path of a subscription needs."""

from __future__ import annotations

from rcp_kernel.tree.entry import Entry
from rcp_streams.filtered import (
    FilteredPathSubscription,
    ViewSubscription,
    VisibilityFilteredSubscription,
)
from rcp_streams.path_subscription import PathSubscription
from rcp_streams.shared_fanout import SharedPathSubscription
from rcp_streams.subscription import Subscription

__all__ = ["new_path_subscription"]


def new_path_subscription(subscription: Subscription, entry: Entry) -> PathSubscription:
    """Create the path subscription of an entry: the first of these kinds that it needs."""
    outbox = subscription.outbox
    view = subscription.view(entry)
    if view is not None:
        return ViewSubscription(subscription, entry, outbox, view)
    if (shown := subscription.visibility_filter(entry)) is not None:
        return VisibilityFilteredSubscription(subscription, entry, outbox, shown)
    if (framed := subscription.framed(entry)) is not None:
        return framed.feed(subscription, entry, outbox)
    options = subscription.options
    if not options.plain:
        return FilteredPathSubscription(subscription, entry, outbox)
    alone = options.qos.reliability == "reliable" or (outbox is not None and outbox.alone)
    kind = PathSubscription if alone or options.count is not None else SharedPathSubscription
    return kind(subscription, entry, outbox)
