"""Names and paths that were probably meant, in place of one that is unknown."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher
from heapq import nsmallest

__all__ = ["Nearest", "closest", "nearest"]

_ALIKE = 0.6  # least likeness of what is proposed: `lvl` and `level` are alike, `foo` and `robot` are not
_EXTRA = 0.9  # likeness of two paths of which one has one segment more
_LONGEST = 512  # characters compared of a path, which may come from anybody
_SEGMENT = 64  # characters compared of a name: the time grows with their square


class Nearest:
    """A search that takes one known name at a time: the comparisons of many take long."""

    def __init__(self, name: str) -> None:
        self._parts = _parts(name)
        self._found: list[tuple[float, str]] = []

    def compare(self, known: str) -> None:
        """Compare a known name."""
        likeness = _likeness(self._parts, _parts(known))
        if likeness >= _ALIKE:
            self._found.append((-likeness, known))

    def found(self, most: int = 3) -> list[str]:
        """Return the names that may be meant, the most similar first."""
        return [name for _, name in nsmallest(most, self._found)]


def nearest(name: str, known: Iterable[str], most: int = 3) -> list[str]:
    """Return the known names that may be meant by an unknown one, the most similar first."""
    search = Nearest(name)
    for one in known:
        search.compare(one)
    return search.found(most)


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is probably meant by an unknown one."""
    return next(iter(nearest(name, known, 1)), None)


def _parts(name: str) -> list[str]:
    return [part[:_SEGMENT] for part in name[:_LONGEST].casefold().split("/")]


def _likeness(one: list[str], other: list[str]) -> float:
    """Return how similar two names are, up to 1; paths by the segments in which they differ.

    What paths have in common would make all of them similar.
    """
    if len(one) == len(other):
        return _least(one, other)
    longer, shorter = (one, other) if len(one) > len(other) else (other, one)
    extra = next((n for n, part in enumerate(shorter) if part != longer[n]), len(shorter))
    is_inside = extra < len(shorter)  # what is above or below a path is not the same thing
    return _EXTRA if is_inside and longer[extra + 1 :] == shorter[extra:] else 0.0


def _least(one: list[str], other: list[str]) -> float:
    """Return the likeness of the segments that are least alike; 0 as soon as two are not."""
    least = 1.0
    for pair in zip(one, other, strict=True):
        least = min(least, _ratio(*pair))
        if least == 0.0:
            break
    return least


def _ratio(one: str, other: str) -> float:
    if one == other:
        return 1.0
    matcher = SequenceMatcher(None, one, other, autojunk=False)
    if matcher.real_quick_ratio() < _ALIKE or matcher.quick_ratio() < _ALIKE:
        return 0.0
    return matcher.ratio()
