"""The names that are most like a misspelt one."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher
from heapq import nlargest
from itertools import islice

__all__ = ["Nearest", "nearest"]

_COMPARED = 2000  # names that a misspelt one is compared with
_AT_ONCE = 400  # in one step
_LONGEST = 512  # characters of one that are compared
_TOLD = 3


class Nearest:
    """A search for names like a wrong one, in steps: comparing them is dear."""

    def __init__(self, name: str, cutoff: float) -> None:
        """`cutoff` says how like, up to 1."""
        self._matcher = SequenceMatcher()
        self._matcher.set_seq2(name[:_LONGEST])
        self._cutoff = cutoff
        self._found: list[tuple[float, str]] = []
        self._compared = 0

    @property
    def full(self) -> bool:
        """Whether it was compared with enough."""
        return self._compared >= _COMPARED

    def compare(self, name: str) -> None:
        """Compare a known name."""
        self._compared += 1
        matcher, cutoff = self._matcher, self._cutoff
        matcher.set_seq1(name)
        if (
            matcher.real_quick_ratio() >= cutoff
            and matcher.quick_ratio() >= cutoff
            and (ratio := matcher.ratio()) >= cutoff
        ):
            self._found.append((ratio, name))

    @property
    def found(self) -> list[str]:
        """The most alike, the best first."""
        return [name for _, name in nlargest(_TOLD, self._found)]


def nearest(name: str, known: Iterable[str], cutoff: float = 0.5) -> list[str]:
    """Return the names that are most like a wrong one, among the first of the known ones."""
    near = Nearest(name, cutoff)
    for one in islice(known, _AT_ONCE):
        near.compare(one)
    return near.found
