"""The paths that a record names beside its own: whoever may not see one of them is not told of it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

__all__ = ["EVERYTHING", "MOST_TOUCHES", "bounded_touches"]

EVERYTHING = "/**"
"""Stands among paths for all there are: what is about it is for those from whom nothing is hidden."""
MOST_TOUCHES = 256
"""Paths that a record names beside its own; what is about more of them is about everything."""


def bounded_touches(paths: Iterable[str]) -> tuple[str, ...]:
    """Return each path once; `EVERYTHING` instead if they are too many, or it is one of them."""
    found = tuple(islice(dict.fromkeys(paths), MOST_TOUCHES + 1))
    return (EVERYTHING,) if len(found) > MOST_TOUCHES or EVERYTHING in found else found
