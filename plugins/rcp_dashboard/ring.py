"""The samples of one watched field: times and values side by side; the oldest are dropped."""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right

__all__ = ["Ring"]


class Ring:
    """A bounded sequence of samples; memory is allocated as it fills."""

    __slots__ = ("_last", "_next", "_ordered", "_size", "_times", "_values", "skipped")

    def __init__(self, size: int) -> None:
        self._size = size
        self._times = array("d")
        self._values = array("d")
        self._next = 0
        """Index of the next sample once the ring is full."""
        self._last = float("-inf")
        self._ordered = True
        """Whether the robot's clock has never gone back."""
        self.skipped = 0
        """Number of samples whose field was not a finite number."""

    def __len__(self) -> int:
        return len(self._times)

    def add(self, time: float, value: float) -> None:
        """Add a sample; `time` in s since the epoch."""
        if time < self._last:
            self._ordered = False
        self._last = time
        if len(self._times) < self._size:
            self._times.append(time)
            self._values.append(value)
            return
        place = self._next
        self._times[place] = time
        self._values[place] = value
        self._next = place + 1 if place + 1 < self._size else 0

    def window(
        self, length: float | None, until: float | None = None
    ) -> tuple[list[float], list[float]]:
        """Return times and values in order of arrival, of the `length` s that end at `until`.

        Without `until` they end with the newest sample, regardless of the robot's clock.
        """
        times = [*self._times[self._next :], *self._times[: self._next]]
        values = [*self._values[self._next :], *self._values[: self._next]]
        if not times or (length is None and until is None):
            return times, values
        end = max(times) if until is None else until
        begin = float("-inf") if length is None else end - length
        if self._ordered:
            kept = slice(bisect_left(times, begin), bisect_right(times, end))
            return times[kept], values[kept]
        inside = [place for place, time in enumerate(times) if begin <= time <= end]
        return [times[place] for place in inside], [values[place] for place in inside]
