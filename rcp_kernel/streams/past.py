"""Earlier samples for a client that asks for history or comes back: judged in steps.

Filters, and what the rules hide, take time for each of up to a thousand samples.
"""

from __future__ import annotations

from collections.abc import Generator

from rcp_kernel.streams.filters import seconds
from rcp_kernel.streams.path_subscription import PathSubscription
from rcp_kernel.tree.samples import Sample

__all__ = ["admitted", "past"]

_STEP = 16  # samples that are judged at once


def past(feed: PathSubscription, history: int | str, last: int) -> list[Sample]:
    """Return the samples that `history` asks for, oldest first, and all after number `last`."""
    ring = list(feed.entry.ring)
    if isinstance(history, int):
        newer = sum(sample.seq > last for sample in ring)
        return ring[-history - newer :] if history + newer else []
    since = feed.entry.clock.now() - int(seconds(history) * 1e9)
    return [sample for sample in ring if sample.received >= since or sample.seq > last]


def admitted(feed: PathSubscription, samples: list[Sample]) -> Generator[None, None, list[Sample]]:
    """Return what passes a feed's filters of `samples`, and of those that come meanwhile."""
    if not feed.judges:
        return samples
    found: list[Sample] = []
    while samples:
        for number, sample in enumerate(samples, 1):
            if (told := feed.admit(sample)) is not None:
                found.append(told)
            if not number % _STEP:
                yield
        last = samples[-1].seq
        samples = [sample for sample in feed.entry.ring if sample.seq > last]
    return found
