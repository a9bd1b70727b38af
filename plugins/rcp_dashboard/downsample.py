"""Down-sampling for plots. Pure functions that return indices."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

__all__ = ["METHODS", "lttb", "minmax"]


def minmax(_: Sequence[float], values: Sequence[float], points: int) -> list[int]:
    """Choose the ends, and the minimum and maximum of each bucket between them.

    No extreme is lost. `values` are finite, `points` is at least 4; returns at most that many
    indices, in order.
    """
    count = len(values)
    if count <= points:
        return list(range(count))
    buckets = (points - 2) // 2
    chosen = [0]
    for low, high in _buckets(count, buckets):
        part = values[low:high]
        least, most = low + part.index(min(part)), low + part.index(max(part))
        chosen += (least,) if least == most else sorted((least, most))
    chosen.append(count - 1)
    return chosen


def lttb(times: Sequence[float], values: Sequence[float], points: int) -> list[int]:
    """Choose by largest triangles (LTTB, Steinarsson 2013): fewer points than `minmax`, smoother.

    From each bucket it takes the sample with the largest triangle between the previous choice and
    the mean of the next bucket.
    """
    count = len(values)
    if count <= points:
        return list(range(count))
    buckets = [*_buckets(count, points - 2), (count - 1, count)]
    chosen = [0]
    for (low, high), (after, end) in itertools.pairwise(buckets):
        size = end - after
        time_c, value_c = sum(times[after:end]) / size, sum(values[after:end]) / size
        time_a, value_a = times[chosen[-1]], values[chosen[-1]]
        wide, tall = time_a - time_c, value_c - value_a
        best, found = -1.0, low
        for index in range(low, high):
            area = abs(wide * (values[index] - value_a) - (time_a - times[index]) * tall)
            if area > best:
                best, found = area, index
        chosen.append(found)
    chosen.append(count - 1)
    return chosen


METHODS = {"minmax": minmax, "lttb": lttb}


def _buckets(count: int, buckets: int) -> list[tuple[int, int]]:
    """Split the samples between the ends into buckets; none is empty."""
    inner = count - 2
    edges = [1 + inner * place // buckets for place in range(buckets + 1)]
    return list(itertools.pairwise(edges))
