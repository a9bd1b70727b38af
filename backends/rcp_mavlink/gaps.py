"""Received and missing parts of a byte range."""

from __future__ import annotations

from bisect import bisect_right

__all__ = ["Gaps"]


class Gaps:
    """The bytes from `start` to `stop`, which may prove to end earlier."""

    def __init__(self, start: int, stop: int) -> None:
        self._start, self._stop = start, stop
        self._data = bytearray()
        self._missing: list[tuple[int, int]] = [(start, stop)] if stop > start else []

    def first(self) -> tuple[int, int] | None:
        """Return the first missing range."""
        return self._missing[0] if self._missing else None

    def add(self, at: int, piece: bytes) -> int:
        """Add received bytes; return how many of them were missing."""
        missing, fresh = self._missing, 0
        stop = at + len(piece)
        place = max(0, bisect_right(missing, (at, self._stop)) - 1)
        while place < len(missing) and missing[place][0] < stop:
            a, b = missing[place]
            low, high = max(a, at), min(b, stop)
            if low >= high:
                place += 1
                continue
            self._put(low, piece[low - at : high - at])
            fresh += high - low
            left = [part for part in ((a, low), (high, b)) if part[0] < part[1]]
            missing[place : place + 1] = left
            place += len(left)
        return fresh

    def _put(self, at: int, piece: bytes) -> None:
        begin = at - self._start
        if begin > len(self._data):
            self._data.extend(bytes(begin - len(self._data)))
        self._data[begin : begin + len(piece)] = piece

    def end(self, at: int) -> None:
        """Set the end: there are no bytes from this offset on."""
        self._stop = max(self._start, min(self._stop, at))
        self._missing = [(a, min(b, at)) for a, b in self._missing if a < at]
        del self._data[self._stop - self._start :]

    @property
    def part(self) -> float:
        """The received fraction, 0…1."""
        whole = self._stop - self._start
        left = sum(b - a for a, b in self._missing)
        return 1 - left / whole if whole else 1.0

    @property
    def data(self) -> bytes:
        """The received bytes; complete when nothing is missing."""
        return bytes(self._data)
