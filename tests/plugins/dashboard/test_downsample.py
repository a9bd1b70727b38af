"""Down-sampling by its laws, and beside models that are written as the papers have it."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_dashboard.downsample import METHODS, lttb, minmax

VALUES = st.lists(st.integers(-1000, 1000).map(float), max_size=300)
POINTS = st.integers(4, 60)


def at(values: Sequence[float]) -> list[float]:
    return [float(place) for place in range(len(values))]


@pytest.mark.parametrize("method", METHODS)
@given(values=VALUES, points=POINTS)
def test_what_is_chosen_is_in_order_and_no_more_than_asked(
    method: str, values: list[float], points: int
) -> None:
    chosen = METHODS[method](at(values), values, points)
    assert chosen == sorted(set(chosen))
    assert set(chosen) <= set(range(len(values)))
    assert len(chosen) == len(values) if len(values) <= points else len(chosen) <= points
    if values:
        assert chosen[0] == 0
        assert chosen[-1] == len(values) - 1


@given(values=VALUES, points=POINTS)
def test_no_extreme_is_lost_between_least_and_greatest(values: list[float], points: int) -> None:
    kept = [values[place] for place in minmax(at(values), values, points)]
    if values:
        assert (min(kept), max(kept)) == (min(values), max(values))


@given(
    values=st.lists(st.integers(-1000, 1000).map(float), min_size=61, max_size=300), points=POINTS
)
def test_each_bucket_gives_its_least_and_its_greatest(values: list[float], points: int) -> None:
    buckets = (points - 2) // 2
    kept = {0, len(values) - 1}
    for place in range(buckets):
        low = 1 + (len(values) - 2) * place // buckets
        high = 1 + (len(values) - 2) * (place + 1) // buckets
        inside = range(low, high)
        kept.add(min(inside, key=lambda index: (values[index], index)))
        kept.add(max(inside, key=lambda index: (values[index], -index)))
    assert minmax(at(values), values, points) == sorted(kept)


def area(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the area of a triangle, by the shoelace formula."""
    return abs(a[0] * (b[1] - c[1]) + b[0] * (c[1] - a[1]) + c[0] * (a[1] - b[1]))


@given(
    values=st.lists(st.integers(-1000, 1000).map(float), min_size=61, max_size=300), points=POINTS
)
def test_every_chosen_one_makes_a_largest_triangle(values: list[float], points: int) -> None:
    times = at(values)
    chosen = lttb(times, values, points)
    assert len(chosen) == points
    inner = len(values) - 2
    edges = [1 + inner * place // (points - 2) for place in range(points - 1)]
    for place in range(points - 2):
        low, high = edges[place], edges[place + 1]
        after = range(high, edges[place + 2]) if place + 2 < len(edges) else range(high, high + 1)
        mean = (sum(after) / len(after), sum(values[i] for i in after) / len(after))
        before = (times[chosen[place]], values[chosen[place]])
        areas = {i: area(before, (times[i], values[i]), mean) for i in range(low, high)}
        assert areas[chosen[place + 1]] == pytest.approx(max(areas.values()))


def test_a_spike_in_a_flat_line_stays() -> None:
    values = [0.0] * 5000
    values[3210] = 9.0
    for choose in METHODS.values():
        assert 3210 in choose(at(values), values, 40)
