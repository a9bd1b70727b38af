"""Suggestions of known names similar to a misspelt one."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher
from heapq import nlargest
from itertools import islice

__all__ = ["Nearest", "nearest"]

_COMPARED = 2000  # names compared with a misspelt one
_AT_ONCE = 400  # names per step
_LONGEST = 512  # characters of a name that are compared
_TOLD = 3


class Nearest:
    """A search for similar names, in steps because comparisons are expensive."""

    def __init__(self, name: str, cutoff: float) -> None:
        """Start a search; `cutoff` is the required similarity, up to 1."""
        self._matcher = SequenceMatcher()
        self._matcher.set_seq2(name[:_LONGEST])
        self._cutoff = cutoff
        self._found: list[tuple[float, str]] = []
        self._compared = 0

    @property
    def full(self) -> bool:
        """Whether the limit of comparisons is reached."""
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
        """The most similar names, best first."""
        return [name for _, name in nlargest(_TOLD, self._found)]


def nearest(name: str, known: Iterable[str], cutoff: float = 0.5) -> list[str]:
    """Return the known names most similar to `name`; compares only the first of them."""
    near = Nearest(name, cutoff)
    for one in islice(known, _AT_ONCE):
        near.compare(one)
    return near.found
