"""How late the samples of a device arrive."""

from __future__ import annotations

__all__ = ["Lateness"]

_WINDOW = 10.0  # s: clocks that are kept drift apart by less than 1 ms in it
_RISE = 0.1  # s by which the least difference of a window rises only with a slow clock or link
_RISES = 2  # windows in a row, after which the clock counts as slow


class Lateness:
    """How late stamped samples of one device arrive, whatever its clock shows.

    The least difference of arrival and stamp in the last 10 to 20 s bounds the difference of the
    clocks: nothing arrives before it was measured. A delay that is constant cannot be seen, nor
    any of a clock that runs slowly, as in a simulation below real time.
    """

    def __init__(self, most: float = 10.0) -> None:
        """Take a sample that is later than `most` (s) for one of a clock that was set back."""
        self._most = most
        self._least: float | None = None
        self._before: float | None = None
        """The least difference of this window and of the one before, s."""
        self._began = float("-inf")
        self._rises = 0

    def of(self, apart: float, now: float) -> float:
        """Return by how much (s) a sample is later than the promptest.

        `apart` is the difference of its arrival and its stamp in s, `now` monotonic.
        """
        if self._least is None:
            self._least, self._began = apart, now
        elif now - self._began > _WINDOW:
            rose = self._before is not None and self._least - self._before > _RISE
            self._rises = self._rises + 1 if rose else 0
            self._before, self._least, self._began = self._least, apart, now
        self._least = min(self._least, apart)
        least = self._least if self._before is None else min(self._least, self._before)
        if apart - least > self._most:
            self._before, self._least, self._began = None, apart, now
            return 0.0
        return 0.0 if self._rises >= _RISES else apart - least
