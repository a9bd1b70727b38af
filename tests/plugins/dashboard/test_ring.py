"""The ring of samples, beside a list."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rcp_dashboard.ring import Ring

TIMES = st.lists(st.integers(0, 60).map(float), max_size=80)
LENGTH = st.none() | st.floats(0.1, 100)


@given(times=TIMES, ordered=st.booleans(), size=st.integers(1, 40), length=LENGTH, until=LENGTH)
def test_a_window_is_what_a_list_would_give(
    times: list[float],
    ordered: bool,  # noqa: FBT001 - drawn by hypothesis
    size: int,
    length: float | None,
    until: float | None,
) -> None:
    samples = [
        (time, float(place)) for place, time in enumerate(sorted(times) if ordered else times)
    ]
    ring = Ring(size)
    for time, value in samples:
        ring.add(time, value)
    kept = samples[-size:]
    if kept and (length is not None or until is not None):
        end = max(time for time, _ in kept) if until is None else until
        begin = float("-inf") if length is None else end - length
        kept = [sample for sample in kept if begin <= sample[0] <= end]
    found, values = ring.window(length, until)
    assert list(zip(found, values, strict=True)) == kept
    assert len(ring) == min(len(samples), size)
