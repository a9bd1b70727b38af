"""Earlier samples for a client that requests history or resumes, filtered in steps.

Filters and access rules take time for each of up to a thousand samples.
"""

from __future__ import annotations

from collections.abc import Generator

from rcp_kernel.tree.samples import Sample
from rcp_streams.options import seconds
from rcp_streams.path_subscription import PathSubscription

__all__ = ["admitted", "past"]

_STEP = 16  # samples filtered per step


def past(feed: PathSubscription, history: int | str, last: int) -> list[Sample]:
    """Return the samples that `history` selects, oldest first, and all after number `last`."""
    ring = list(feed.entry.ring)
    if isinstance(history, int):
        newer = sum(sample.seq > last for sample in ring)
        return ring[-history - newer :] if history + newer else []
    since = feed.entry.clock.now() - int(seconds(history) * 1e9)
    return [sample for sample in ring if sample.received >= since or sample.seq > last]


def admitted(feed: PathSubscription, samples: list[Sample]) -> Generator[None, None, list[Sample]]:
    """Return those of `samples`, and of samples published meanwhile, that pass a feed's filters."""
    if not feed.judges:
        return samples
    passed: list[Sample] = []
    while samples:
        for number, sample in enumerate(samples, 1):
            if (admitted := feed.admit(sample)) is not None:
                passed.append(admitted)
            if not number % _STEP:
                yield
        last = samples[-1].seq
        samples = [sample for sample in feed.entry.ring if sample.seq > last]
    return passed
